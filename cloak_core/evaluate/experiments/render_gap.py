"""The same cloaked bodies in our renders and in Blender's Cycles: what our light model leaves out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from PIL import Image

from cloak_core.evaluate.controls import CLOTHING, LOGO
from cloak_core.evaluate.cycles import LIGHTS, SAMPLES, CyclesStage, image_difference, render_frames, require_blender
from cloak_core.evaluate.experiments.attacks import MULTI, repeated
from cloak_core.evaluate.experiments.lab import Lab, Trained
from cloak_core.evaluate.experiments.logos import chest_thighs
from cloak_core.evaluate.experiments.outcome import Outcome
from cloak_core.evaluate.experiments.repeats import Repeats
from cloak_core.evaluate.experiments.wording import file_name, rate_text, said
from cloak_core.evaluate.figures import SERIES, WIDTH, legend_above, new_figure, panel_title, percent_axis
from cloak_core.evaluate.pictures import to_pil
from cloak_core.evaluate.report.words import short_name
from cloak_core.evaluate.settings import EvaluateSettings
from cloak_core.evaluate.stage import Stage

OURS = "ours"
NAMES = {OURS: "our renders", "matching": "Cycles, matching light", "studio": "Cycles, studio", "sky": "Cycles, sky"}
CONTROLS = (CLOTHING, "grey", "random", "stripes", "checks")


def render_gap(lab: Lab) -> Outcome:
    """Chest + thighs against every detector: tested on our images and on Cycles' of the same bodies and cameras."""
    require_blender()  # said before anything is trained
    quick = lab.options.quick
    angles = (-8.0, 4.0) if quick else tuple(float(a) for a in range(-10, 11, 5))
    settings = lab.evaluate_settings(images_per_view=4 * lab.options.test_images)
    rows, panels, pictures, paths = [], {}, {}, SAMPLES // 2 if quick else SAMPLES
    for spec in lab.specs:
        trained = repeated(lab, chest_thighs(lab.materials.bodies), [spec], angles=MULTI)[0]
        stage = _plain_stage(lab, trained, angles, settings)
        frames = render_frames(stage, (LOGO, *CONTROLS), lab.options.out / "frames", paths, lab.tell)
        stages = {OURS: stage} | {light: CyclesStage(stage, frames, light) for light in LIGHTS}
        results = {name: _measured(lab, trained, spec, made, name, angles, settings) for name, made in stages.items()}
        ours = results[OURS].rate(spec).value
        for name, result in results.items():
            same = {} if name == OURS else image_difference(stage, stages[name])
            gap = {"gap": None if name == OURS else round(ours - result.rate(spec).value, 4)}
            gap |= {f"image_{key}": round(value, 4) for key, value in same.items()}
            rows.append({"render": NAMES[name]} | result.row(spec) | gap)
        panels[spec] = results
        pictures[f"renders-{file_name(spec)}"] = _sheet(stages)
    rows = [{key: row.get(key) for key in rows[-1]} for row in rows]
    words = _words(lab, rows, len(angles), paths)
    return Outcome("The gap between our renders and Cycles", rows, words, {"gap": _figure(panels)}, pictures=pictures)


def _plain_stage(lab: Lab, trained: Trained, angles: tuple[float, ...], settings: EvaluateSettings) -> Stage:
    """The lab's stage in the first outfit: every other would need frames of its own."""
    stage = lab.stage(trained, angles, settings)
    stage.trials = replace(stage.trials, outfit=np.zeros_like(stage.trials.outfit))
    return stage


def _measured(
    lab: Lab, trained: Trained, spec: str, stage: Stage, name: str, angles: tuple, settings: EvaluateSettings
) -> Repeats:
    frames = {} if name == OURS else {"frames": stage.frames, "light": name}
    bodies = lab.materials.unseen
    return Repeats([lab.measured(lambda: stage, trained, bodies, (spec,), angles, settings, outfit=0, **frames)])


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


def _words(lab: Lab, rows: list[dict], angles: int, paths: int) -> list[str]:
    words = [
        f"Chest + thighs, trained at five angles in our own renders. Each of {lab.materials.unseen.pose_count} unseen "
        f"bodies in its first outfit was rendered at {angles} azimuths by Cycles ({paths} paths per pixel, not "
        "denoised, view transform Standard) under three lights, and put before the same unseen backgrounds as our own "
        "render. Matching: even light and one distant lamp without shadows, as our model has them, on a matte surface "
        "(our highlight is left out). Studio: two area lamps and a dim room. Sky: a sun, sky and ground. Both have "
        "shadows, reflected light and a slightly glossy cloth. The sheet shows, from left to right, our render, "
        "matching, studio and sky. A gap is our success minus that in Cycles."
    ]
    for spec in lab.specs:
        mine = {row["render"]: row for row in rows if row["detector"] == spec}
        text = f"{short_name(spec)}: our renders {said(mine[NAMES[OURS]])}"
        for light in LIGHTS:
            row = mine[NAMES[light]]
            text += (
                f"; {NAMES[light]} {said(row)}, a gap of {100 * row['gap']:.1f} points (own clothing "
                f"{rate_text(row['clothing'])}; the images differ by {row['image_rms']:.3f} rms on the body)"
            )
        words.append(text + ".")
    return words


def _figure(panels: dict[str, dict[str, Repeats]]) -> object:
    figure, axes = new_figure(WIDTH, 2.9, len(panels), sharey=True)
    for axis, (spec, results) in zip(axes, panels.items(), strict=True):
        for k, control in enumerate((LOGO, CLOTHING, "stripes")):
            look, at = SERIES[control], np.arange(len(results)) + 0.16 * (k - 1)
            rates = [result.rate(spec, control) for result in results.values()]
            value = np.array([r.value for r in rates])
            error = np.abs(np.array([[r.low, r.high] for r in rates]).T - value)
            axis.errorbar(
                at, value, error, fmt=look.marker, color=look.color, lw=1.2, capsize=2, label=look.label, clip_on=False
            )
        axis.set_xticks(range(len(results)), ["ours", *(f"Cycles,\n{light}" for light in LIGHTS)])
        axis.set_xlim(-0.5, len(results) - 0.5)
        axis.grid(axis="x", visible=False)
        panel_title(axis, short_name(spec), len(panels))
    percent_axis(axes[0])
    legend_above(figure)
    return figure
