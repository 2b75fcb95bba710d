"""The same cloaked bodies in our renders and in Blender's Cycles: what our light model leaves out."""

from __future__ import annotations

import numpy as np
import torch
from PIL import Image

from cloak_core.core.evaluate import Patterns
from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.core.evaluation.statistics import training_row
from cloak_core.core.images import ImageSet
from cloak_core.core.logo import chest_thighs
from cloak_core.core.pattern import Pattern
from cloak_core.experiments.declaration import MULTI, Bars, Experiment, Numbers, RunStore
from cloak_core.experiments.runner import threshold_rows
from cloak_core.studies.cycles import (
    LIGHTS,
    SAMPLES,
    CyclesImages,
    cycles_command,
    image_difference,
    render_frames,
)
from cloak_core.studies.report.charts import Rows
from cloak_core.studies.report.pictures import to_pil
from cloak_core.studies.report.words import file_name

NAMES = {"ours": "our renders", "matching": "Cycles, matching light", "studio": "Cycles, studio", "sky": "Cycles, sky"}


def measure(store: RunStore) -> Numbers:
    """Judge every detector's cloak on our images and on Cycles' of the same bodies and cameras."""
    cycles_command()  # said before anything is trained
    quick = store.options.quick
    unseen = store.split.unseen
    angles = (-8.0, 4.0) if quick else tuple(float(a) for a in range(-10, 11, 5))
    settings = store.evaluate_settings(images_per_view=4 * store.options.test_images)
    rows: Rows = []
    thresholds: Rows = []
    pictures = {}
    paths = SAMPLES // 2 if quick else SAMPLES
    for spec in store.specs:
        trained = store.train_repetitions(chest_thighs(store.split.bodies), [spec], angles=MULTI)[0]
        ours, patterns = store.shown(trained.pattern, angles, settings, unseen)
        ours.trials = ours.trials.assign(outfit=0)  # every other outfit would need frames of its own
        frames = render_frames(ours, patterns, store.options.out / "frames", paths, store.tell)
        sets = {"ours": ours} | {light: CyclesImages.of(ours, patterns, frames, light) for light in LIGHTS}
        row_of = {}
        for name, images in sets.items():
            judge = {spec: store.split.detectors[spec]}
            results = store.measure_once(images, patterns, judge, settings, trained.folder.name)
            row_of[name] = {"render": NAMES[name]} | training_row(results, spec)
            thresholds += threshold_rows(row_of[name], results, spec)
        rows += [row | _gap(row_of["ours"], row, ours, sets[name], trained.pattern) for name, row in row_of.items()]
        pictures[f"renders-{file_name(spec)}"] = _sheet(sets, patterns)
    return Numbers(rows, {"bodies": unseen.pose_count, "angles": len(angles), "paths": paths}, thresholds, pictures)


def _gap(our_row: dict, row: dict, ours: ImageSet, shown: ImageSet, pattern: Pattern) -> dict:
    """Compare our success and images with those of `shown`; None where it is our own."""
    if shown is ours:
        return dict.fromkeys(("gap", "image_rms", "image_inside", "image_bias"))
    difference = image_difference(ours, shown, pattern)
    gap = round(our_row["success"] - row["success"], 4)
    return {"gap": gap} | {f"image_{key}": round(value, 4) for key, value in difference.items()}


def _sheet(sets: dict[str, ImageSet], patterns: Patterns) -> Image.Image:
    """Draw the first image of two bodies, cloaked and in own clothing, a row each; renders side by side."""
    pose = sets["ours"].trials["pose"].to_numpy()
    rows = [
        torch.cat([r.render([int(np.flatnonzero(pose == body)[0])], patterns[name])[0] for r in sets.values()], 2)
        for body in np.unique(pose)[:2]
        for name in (LOGO, CLOTHING)
    ]
    picture = to_pil(torch.cat(rows, 1))
    return picture.resize((1000, round(1000 * picture.height / picture.width)), Image.Resampling.LANCZOS)


RENDER_GAP = Experiment(
    title="The gap between our renders and Cycles",
    caption="Chest + thighs, trained at five angles in our own renders. Each unseen body in its first outfit is "
    "rendered by Cycles (not denoised, view transform Standard) under three lights, and put before the same unseen "
    "backgrounds as our own render. Matching: even light and one distant lamp without shadows, as our model has them, "
    "on a matte surface (our highlight is left out). Studio: two area lamps and a dim room. Sky: a sun, sky and "
    "ground. Both have shadows, reflected light and a slightly glossy cloth. The sheet shows, from left to right, our "
    "render, matching, studio and sky. The gap is our success minus that in Cycles; image rms and bias are of display "
    "colours on the body.",
    measure=measure,
    figures={"gap": Bars(y="render", panel="detector", controls=(CLOTHING, "stripes"))},
)
