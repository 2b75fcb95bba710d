"""The same cloaked bodies in our renders and in Blender's Cycles: what our light model leaves out."""

from __future__ import annotations

import numpy as np
import torch
from PIL import Image

from cloak_core.core.evaluation.controls import CLOTHING, LOGO
from cloak_core.core.evaluation.renderer import BodyRenderer, render_images
from cloak_core.core.evaluation.statistics import training_row
from cloak_core.core.logo import chest_thighs
from cloak_core.experiments.declaration import MULTI, Bars, Experiment, Numbers, RunStore
from cloak_core.experiments.runner import threshold_rows
from cloak_core.studies.cycles import (
    LIGHTS,
    SAMPLES,
    CyclesRenderer,
    image_difference,
    render_frames,
    require_blender,
)
from cloak_core.studies.report.pictures import to_pil
from cloak_core.studies.report.words import file_name
from cloak_core.studies.store import CONTROLS

NAMES = {"ours": "our renders", "matching": "Cycles, matching light", "studio": "Cycles, studio", "sky": "Cycles, sky"}


def measure(store: RunStore) -> Numbers:
    """Judge every detector's cloak on our images and on Cycles' of the same bodies and cameras."""
    require_blender()  # said before anything is trained
    quick, unseen = store.options.quick, store.split.unseen
    angles = (-8.0, 4.0) if quick else tuple(float(a) for a in range(-10, 11, 5))
    settings = store.evaluate_settings(images_per_view=4 * store.options.test_images)
    rows, thresholds, pictures, paths = [], [], {}, SAMPLES // 2 if quick else SAMPLES
    for spec in store.specs:
        trained = store.train_repetitions(chest_thighs(store.split.bodies), [spec], angles=MULTI)[0]
        ours = store.renderer(trained, angles, settings, unseen)
        ours.trials = ours.trials.assign(outfit=0)  # every other outfit would need frames of its own
        frames = render_frames(ours, (LOGO, *CONTROLS), store.options.out / "frames", paths, store.tell)
        renderers = {"ours": ours} | {light: CyclesRenderer(ours, frames, light) for light in LIGHTS}
        found = {}
        for name, renderer in renderers.items():
            more = {} if renderer is ours else {"frames": frames.name, "light": name}
            make = lambda renderer=renderer: renderer
            results = store.measured(make, trained, unseen, (spec,), angles, settings, outfit=0, **more)
            found[name] = {"render": NAMES[name]} | training_row(results, spec)
            thresholds += threshold_rows(found[name], results, spec)
        rows += [row | _gap(found["ours"], row, ours, renderers[name]) for name, row in found.items()]
        pictures[f"renders-{file_name(spec)}"] = _sheet(renderers)
    return Numbers(rows, {"bodies": unseen.pose_count, "angles": len(angles), "paths": paths}, thresholds, pictures)


def _gap(our_row: dict, row: dict, ours: BodyRenderer, shown: BodyRenderer) -> dict:
    """Compare our success and images with those of `shown`; None where it is our own."""
    if shown is ours:
        return dict.fromkeys(("gap", "image_rms", "image_inside", "image_bias"))
    difference = image_difference(ours, shown)
    gap = round(our_row["success"] - row["success"], 4)
    return {"gap": gap} | {f"image_{key}": round(value, 4) for key, value in difference.items()}


def _sheet(renderers: dict[str, BodyRenderer]) -> Image.Image:
    """Draw the first image of two bodies, cloaked and in own clothing, a row each; renders side by side."""
    pose = renderers["ours"].trials["pose"].to_numpy()
    rows = [
        torch.cat([render_images(r, [int(np.flatnonzero(pose == body)[0])], control)[0] for r in renderers.values()], 2)
        for body in np.unique(pose)[:2]
        for control in (LOGO, CLOTHING)
    ]
    picture = to_pil(torch.cat(rows, 1))
    return picture.resize((1000, round(1000 * picture.height / picture.width)), Image.Resampling.LANCZOS)


EXPERIMENT = Experiment(
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
    order=10,
)
