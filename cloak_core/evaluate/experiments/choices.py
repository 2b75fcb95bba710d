"""What the settings do: resolution, the choices behind preset `best`, and cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from matplotlib.ticker import LogFormatter

from cloak_core.evaluate.experiments.attacks import MULTI, SINGLE, narrow_angles, repeated
from cloak_core.evaluate.experiments.lab import Lab, Trained
from cloak_core.evaluate.experiments.logos import chest_thighs
from cloak_core.evaluate.experiments.outcome import Outcome
from cloak_core.evaluate.experiments.wording import best_row, rate_text, said
from cloak_core.evaluate.figures import (
    CYCLE,
    DASHES,
    MARKERS,
    legend_above,
    new_figure,
    percent_axis,
)
from cloak_core.evaluate.report.words import short_name
from cloak_core.exchange.bodies import Bodies
from cloak_core.render.views import ViewBank
from cloak_core.scene.cameras import Camera
from cloak_core.scene.meshes.subdivision import subdivide

CHANGES: dict[str, dict[str, object]] = {
    "preset best": {},
    "SGD instead of Adam": {"optimizer": "sgd", "lr": 1.0, "momentum": 0.9},
    "learning rate 0.02 instead of 0.05": {"lr": 0.02},
    "learning rate 0.1 instead of 0.05": {"lr": 0.1},
    "constant learning rate": {"schedule": "constant"},
    "loss: objectness": {"loss": "objectness"},
    "loss: log": {"loss": "log"},
    "ten best boxes": {"reduce": "topk"},
    "no total variation": {"tv_weight": 0.0},
    "no photometric noise": {"contrast": "1", "brightness": "0", "noise": 0.0},
    "the paper's photometric range": {"contrast": "0:1", "brightness": "0:1"},
    "no translation": {"translation": 0},
    "one angle": {"angles": SINGLE},
    "from random colours": {"initial": "random"},
    "sigmoid instead of projection": {"gamut": "sigmoid"},
    "half of the images: hard views": {"hard_views": 0.5},
    "occluders, zoom, blur and JPEG": {"occluders": 2, "zoom": "0.8:1.2", "blur": 1.0, "jpeg": "40:95"},
}
"""Each changes one choice of preset `best`."""
QUICK_CHANGES = (
    "preset best",
    "SGD instead of Adam",
    "learning rate 0.02 instead of 0.05",
    "learning rate 0.1 instead of 0.05",
    "loss: log",
    "no total variation",
    "no photometric noise",
    "one angle",
    "half of the images: hard views",
    "occluders, zoom, blur and JPEG",
)

COSTS: dict[str, dict[str, object]] = {
    "exact area, float32, views kept": {},
    "1 sample per pixel": {"samples": 1},
    "detector in bfloat16": {"precision": "bfloat16"},
    "a new view for every image": {"angle_jitter": 2.5},
    "4 samples per pixel": {"samples": 4},
    "16 samples per pixel": {"samples": 16},
    "64 samples per pixel": {"samples": 64},
}
"""What a training can save on; each changes the first."""
FULL_COSTS = ("4 samples per pixel", "16 samples per pixel", "64 samples per pixel")
"""Left out when quick."""


def resolution(lab: Lab) -> Outcome:
    """Subdivision levels: success, time, and how many of the logo's faces any training view gives a gradient."""
    spec = lab.specs[0]
    bodies, unseen, faces = lab.materials.bodies, lab.materials.unseen, chest_thighs(lab.materials.bodies)
    rows = []
    for level in range(2 if lab.options.quick else 3):
        if level:
            bodies, parent = subdivide(bodies)
            unseen, _ = subdivide(unseen)
            faces = np.flatnonzero(np.isin(parent, faces)).astype(np.int64)
        trained = repeated(lab, faces, [spec], bodies=bodies, angles=MULTI)
        result = lab.evaluate(trained, narrow_angles(lab), [spec], bodies=unseen)
        reach = gradient_reach(lab, bodies, faces)
        rows.append({"level": level, "logo_faces": len(faces), "reach": reach} | times(trained) | result.row(spec))
    figure, axes = new_figure(columns=2)
    x = [row["logo_faces"] for row in rows]
    error = np.clip([[r["success"] - r["low"] for r in rows], [r["high"] - r["success"] for r in rows]], 0, None)
    axes[0].errorbar(x, [row["success"] for row in rows], error, color=CYCLE[0], marker="o", capsize=2, label="success")
    axes[0].plot(
        x,
        [row["reach"] for row in rows],
        color=CYCLE[1],
        marker="s",
        ls="--",
        mfc="white",
        zorder=3,
        label="faces with a gradient",
    )
    percent_axis(axes[0], "")
    axes[1].plot(x, [row["cpu_seconds"] for row in rows], color=CYCLE[2], marker="D", clip_on=False)
    axes[1].set_ylim(0, 1.1 * max(row["cpu_seconds"] or 1.0 for row in rows))
    axes[1].set_ylabel("processor time of the training (s)")
    for axis in axes:
        axis.set_xlabel("faces of the logo")
        axis.set_xscale("log")
        axis.set_xticks(x, [f"{faces:,}" for faces in x])
        axis.set_xticks([], minor=True)
    legend_above(figure)
    words = [
        "The same logo on bodies subdivided 0, 1, ... times (each face in four). Reach is the share of its faces that "
        "at least one training view sees; processor time, all threads, includes building the views."
    ]
    words += [f"Level {r['level']}: {said(r)}; reach {rate_text(r['reach'])}, {_said_time(r)}." for r in rows]
    return Outcome("Resolution of the mesh", rows, words, {"resolution": figure})


def times(trained: Sequence[Trained]) -> dict[str, float | None]:
    """Mean `seconds` by the clock on the wall and `cpu_seconds` of the processor, one decimal; None: not measured.

    The second hardly counts what others do on the machine.
    """
    mean = {name: float(np.mean([getattr(t, name) for t in trained])) for name in ("seconds", "cpu_seconds")}
    return {name: None if np.isnan(value) else round(value, 1) for name, value in mean.items()}


def _said_time(row: dict) -> str:
    return "its time was not measured" if row["cpu_seconds"] is None else f"{row['cpu_seconds']:g} s"


def gradient_reach(lab: Lab, bodies: Bodies, faces: np.ndarray) -> float:
    """Share of the faces that get a gradient from the first body's training views."""
    options = {} if lab.options.samples is None else {"samples": lab.options.samples}
    bank = ViewBank(bodies.select_poses([0]), device=lab.options.device, **options)
    seen = torch.zeros(len(faces), dtype=torch.bool, device=bank.device)
    for azimuth in (-10.0, -5.0, 0.0, 5.0, 10.0):
        camera = Camera(azimuth=azimuth, width=lab.options.size, height=lab.options.size)
        seen[bank.dress(0, camera, faces).logo_face] = True
    return round(float(seen.float().mean()), 4)


def ablation(lab: Lab) -> Outcome:
    """Preset `best`, and the same with one choice changed."""
    spec, faces = lab.specs[0], chest_thighs(lab.materials.bodies)
    names = QUICK_CHANGES if lab.options.quick else tuple(CHANGES)
    rows = []
    for name in names:
        trained = repeated(lab, faces, [spec], **({"preset": "best", "angles": MULTI} | CHANGES[name]))
        result = lab.evaluate(trained, narrow_angles(lab), [spec])
        rows.append({"change": name} | times(trained) | result.row(spec))
    figure, (axis,) = new_figure(height=0.7 + 0.26 * len(rows))
    value = np.array([row["success"] for row in rows])
    error = np.clip([[r["success"] - r["low"] for r in rows], [r["high"] - r["success"] for r in rows]], 0, None)
    axis.axvline(value[0], color=CYCLE[6], lw=0.8, ls="--")
    axis.errorbar(value, range(len(rows)), xerr=error, fmt="o", color=CYCLE[0], lw=1.2, clip_on=False)
    axis.set_yticks(range(len(rows)), [row["change"] for row in rows])
    axis.set_ylim(len(rows) - 0.5, -0.5)
    axis.set_xlim(0, 1)
    axis.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0 %", "25 %", "50 %", "75 %", "100 %"])
    axis.set_xlabel("attack success")
    ends = lambda column: [f(rows, key=lambda row: row[column]) for f in (min, max)]
    (worst, best), (low, high) = ends("success"), ends("mean_score")
    words = [
        f"Chest + thighs against {short_name(spec)}: preset best reaches {said(rows[0])}. Each line changes one "
        "choice, with the same number of steps.",
        f"The lowest is '{worst['change']}', {said(worst)}, the highest '{best['change']}', {said(best)}. The mean "
        f"score of the surest person, where less is better, lies between {low['mean_score']:.3f} ('{low['change']}') "
        f"and {high['mean_score']:.3f} ('{high['change']}'); preset best has {rows[0]['mean_score']:.3f}. Differences "
        "within the intervals say nothing.",
    ]
    return Outcome("The choices behind preset best", rows, words, {"changes": figure})


def cost(lab: Lab) -> Outcome:
    """Success against training time: samples per pixel, the detector's precision, views kept or made for each image."""
    spec, faces = lab.specs[0], chest_thighs(lab.materials.bodies)
    full = lab.steps(angles=MULTI)
    shares = (3, 1) if lab.options.quick else (4, 2, 1)
    lengths = sorted({max(1, full // share) for share in shares})
    rows = []
    figure, (axis,) = new_figure()
    for k, (name, changes) in enumerate(COSTS.items()):
        if lab.options.quick and name in FULL_COSTS:
            continue
        line = []
        for steps in lengths:
            trained = repeated(lab, faces, [spec], **({"angles": MULTI, "steps": steps} | changes))
            result = lab.evaluate(trained, narrow_angles(lab), [spec])
            rows.append({"variant": name, "steps": steps} | times(trained) | result.row(spec))
            line.append((rows[-1]["cpu_seconds"], result.rate(spec)))
        known = [(x, r) for x, r in line if x is not None]
        value = np.array([rate.value for _, rate in known])
        error = np.abs(np.array([[rate.low, rate.high] for _, rate in known]).reshape(-1, 2).T - value)
        look = {"color": CYCLE[k], "marker": MARKERS[k], "ls": DASHES[k], "lw": 1.4, "capsize": 2, "elinewidth": 0.8}
        axis.errorbar([x for x, _ in known], value, error, label=name, clip_on=False, **look)
    percent_axis(axis)
    axis.set_xlabel("processor time of the training (s, views included)")
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter(LogFormatter())
    axis.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
    legend_above(figure)
    best = best_row(rows)
    words = [
        f"Chest + thighs against {short_name(spec)}; every cloak is tested with the renderer's default. Processor "
        "time, all threads, is shown because the clock on the wall also counts what others do on the machine.",
        f"The highest success is {said(best)}: {best['variant']}, {best['steps']} steps (the largest of {len(rows)}: "
        "differences within the intervals say nothing).",
    ]
    return Outcome("Success against cost", rows, words, {"cost": figure})
