"""The same cloaked bodies in our renders and in Blender's Cycles: what our light model leaves out.

Chest + thighs against every detector, tested on our images and on Cycles' of the same bodies and cameras.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from matplotlib.figure import Figure
from PIL import Image

from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.cycles import LIGHTS, SAMPLES, CyclesStage, image_difference, render_frames, require_blender
from cloak_core.evaluation.experiments.drawing import errors
from cloak_core.evaluation.experiments.lab import CONTROLS, MULTI, Lab
from cloak_core.evaluation.experiments.numbers import Numbers, column, group, select
from cloak_core.evaluation.experiments.repeats import Repeats
from cloak_core.evaluation.figures import SERIES, WIDTH, legend_above, new_figure, panel_title, percent_axis
from cloak_core.evaluation.pictures import to_pil
from cloak_core.evaluation.report.words import file_name, percent, said, short_name
from cloak_core.evaluation.stage import Stage

TITLE = "The gap between our renders and Cycles"
OURS = "ours"
NAMES = {OURS: "our renders", "matching": "Cycles, matching light", "studio": "Cycles, studio", "sky": "Cycles, sky"}


def measure(lab: Lab) -> Numbers:
    require_blender()  # said before anything is trained
    quick = lab.options.quick
    angles = (-8.0, 4.0) if quick else tuple(float(a) for a in range(-10, 11, 5))
    settings = lab.evaluate_settings(images_per_view=4 * lab.options.test_images)
    rows, pictures, paths = [], {}, SAMPLES // 2 if quick else SAMPLES
    for spec in lab.specs:
        trained = lab.chest_thighs(spec, angles=MULTI)[0]
        stage = lab.stage(trained, angles, settings)
        # In the first outfit: every other would need frames of its own.
        stage.trials = replace(stage.trials, outfit=np.zeros_like(stage.trials.outfit))
        frames = render_frames(stage, (LOGO, *CONTROLS), lab.options.out / "frames", paths, lab.tell)
        stages = {OURS: stage} | {light: CyclesStage(stage, frames, light) for light in LIGHTS}
        found = {}
        for name, shown in stages.items():
            more = {} if name == OURS else {"frames": frames.name, "light": name}
            asked = (trained, lab.materials.unseen, (spec,), angles, settings)
            found[name] = Repeats([lab.measured(_already(shown), *asked, outfit=0, **more)]).row(spec)
        for name, row in found.items():
            points = found[OURS]["success"] - row["success"]
            rows.append({"render": NAMES[name]} | row | _gap(points, stage, stages[name]))
        pictures[f"renders-{file_name(spec)}"] = _sheet(stages)
    return Numbers(rows, {"bodies": lab.materials.unseen.pose_count, "angles": len(angles), "paths": paths}, pictures)


def _already(stage: Stage) -> Callable[[], Stage]:
    return lambda: stage


def _gap(points: float, ours: Stage, shown: Stage) -> dict:
    """How far our success lies above that on `shown`, and how its images differ; None where it is our own."""
    if shown is ours:
        return dict.fromkeys(("gap", "image_rms", "image_inside", "image_bias"))
    difference = image_difference(ours, shown)
    return {"gap": round(points, 4)} | {f"image_{key}": round(value, 4) for key, value in difference.items()}


def _sheet(stages: dict[str, Stage]) -> Image.Image:
    """The first image drawn of two bodies, cloaked and in own clothing, in every render: one row each."""
    trials = next(iter(stages.values())).trials
    rows = []
    for pose in np.unique(trials.pose)[:2]:
        i = int(np.flatnonzero(trials.pose == pose)[0])
        for control in (LOGO, CLOTHING):
            rows.append(torch.cat([s.images([i], control)[0] for s in stages.values()], 2))
    picture = to_pil(torch.cat(rows, 1))
    return picture.resize((1000, round(1000 * picture.height / picture.width)), Image.Resampling.LANCZOS)


def tell(numbers: Numbers) -> list[str]:
    facts = numbers.facts
    words = [
        f"Chest + thighs, trained at five angles in our own renders. Each of {facts['bodies']} unseen bodies in its "
        f"first outfit was rendered at {facts['angles']} azimuths by Cycles ({facts['paths']} paths per pixel, not "
        "denoised, view transform Standard) under three lights, and put before the same unseen backgrounds as our own "
        "render. Matching: even light and one distant lamp without shadows, as our model has them, on a matte surface "
        "(our highlight is left out). Studio: two area lamps and a dim room. Sky: a sun, sky and ground. Both have "
        "shadows, reflected light and a slightly glossy cloth. The sheet shows, from left to right, our render, "
        "matching, studio and sky. A gap is our success minus that in Cycles."
    ]
    for spec, rows in group(numbers.rows, "detector").items():
        text = f"{short_name(spec)}: our renders {said(select(rows, render=NAMES[OURS])[0])}"
        for light in LIGHTS:
            row = select(rows, render=NAMES[light])[0]
            text += (
                f"; {NAMES[light]} {said(row)}, a gap of {100 * row['gap']:.1f} points (own clothing "
                f"{percent(row['clothing'])}; the images differ by {row['image_rms']:.3f} rms on the body)"
            )
        words.append(text + ".")
    return words


def draw(numbers: Numbers) -> dict[str, Figure]:
    panels = group(numbers.rows, "detector")
    figure, axes = new_figure(WIDTH, 2.9, len(panels), sharey=True)
    for axis, (spec, rows) in zip(axes, panels.items(), strict=True):
        look = SERIES[LOGO]
        at, bars = np.arange(len(rows)), {"fmt": look.marker, "color": look.color, "label": look.label}
        axis.errorbar(at - 0.16, column(rows), errors(rows), lw=1.2, capsize=2, clip_on=False, **bars)
        for k, control in enumerate((CLOTHING, "stripes")):
            look = SERIES[control]
            axis.plot(at + 0.16 * k, column(rows, control), look.marker, color=look.color, label=look.label)
        axis.set_xticks(at, ["ours", *(f"Cycles,\n{light}" for light in LIGHTS)])
        axis.set_xlim(-0.5, len(rows) - 0.5)
        axis.grid(axis="x", visible=False)
        panel_title(axis, short_name(spec), len(panels))
    percent_axis(axes[0])
    legend_above(figure)
    return {"gap": figure}
