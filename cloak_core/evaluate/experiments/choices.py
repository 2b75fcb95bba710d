"""What the settings do: total variation, resolution, the choices behind preset `best`, and cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from matplotlib.figure import Figure
from PIL import Image

from cloak_core.evaluate.experiments.attacks import MULTI, SINGLE, narrow_angles, repeated
from cloak_core.evaluate.experiments.lab import Lab, Trained
from cloak_core.evaluate.experiments.logos import chest_thighs
from cloak_core.evaluate.experiments.outcome import Outcome
from cloak_core.evaluate.experiments.views import band
from cloak_core.evaluate.experiments.wording import best_row, rate_text, said
from cloak_core.evaluate.figures import (
    CYCLE,
    DASHES,
    MARKERS,
    WIDTH,
    degree_ticks,
    legend_above,
    new_figure,
    percent_axis,
)
from cloak_core.evaluate.intervals import Rate
from cloak_core.evaluate.report.words import short_name
from cloak_core.render.views import ViewBank
from cloak_core.scene.bodies import subdivide
from cloak_core.scene.cameras import Camera
from cloak_core.scene.exchange import Bodies

PAPER_WEIGHTS = (0.0, 0.1, 2.5, 10.0)
TV_WEIGHTS = (0.0, 0.1, 0.5, 1.0, 2.5, 10.0)
"""Of total variation: the paper's, and two between."""
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
PICTURES = 7
"""Previews of one training in a figure."""
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


def tv(lab: Lab) -> Outcome:
    """Weights of total variation: trained at azimuth 0 on one body, tested around on it and on an unseen one."""
    spec, faces, angles = lab.specs[0], chest_thighs(lab.materials.bodies), narrow_angles(lab)
    one = lab.materials.bodies.select_poses([0])
    tests = {"the trained body": one, "an unseen body": lab.materials.unseen.select_poses([0])}
    weights = PAPER_WEIGHTS if lab.options.quick else TV_WEIGHTS
    settings = lab.train_settings(angles=SINGLE)
    every = max(1, round(5 * settings.epoch_images(len(lab.materials.backgrounds)) / settings.batch))  # 5 epochs
    figure, axes = new_figure(columns=2, sharey=True)
    rows, pictures, results = [], {}, {name: [] for name in tests}
    for k, weight in enumerate(weights):
        trained = repeated(lab, faces, [spec], bodies=one, angles=SINGLE, tv_weight=weight, preview_every=every)
        pictures[weight] = trained[0]
        for axis, (name, bodies) in zip(axes, tests.items(), strict=True):
            images = 4 * lab.options.test_images  # one body instead of several
            result = lab.evaluate(trained, angles, [spec], bodies=bodies, images_per_view=images)
            rows.append({"tv_weight": weight, "test": name} | result.row(spec))
            results[name].append(result.rate(spec))
            # Without bands: those of four curves in one place hide each other. The intervals are in `_weight_figure`.
            rates = [result.rate(spec, angle=a).value for a in angles]
            axis.plot(angles, rates, color=CYCLE[k], marker=MARKERS[k], ls=DASHES[k], label=f"weight {weight:g}")
            axis.set_title(name)
            axis.set_xlabel("azimuth (degrees)")
            degree_ticks(axis)
    percent_axis(axes[0])
    legend_above(figure)
    figures = {"weights": _weight_figure(weights, results), "angles": figure}
    figures |= {"pictures-logos": sheet} if (sheet := _preview_figure(pictures)) else {}
    return Outcome("Total variation", rows, _tv_words(rows, spec), figures)


def _weight_figure(weights: Sequence[float], results: dict[str, list[Rate]]) -> Figure:
    """Success over all angles with its interval against the weight, a series for each test."""
    figure, (axis,) = new_figure()
    for k, (name, rates) in enumerate(results.items()):
        value = np.array([r.value for r in rates])
        error = np.abs(np.array([[r.low, r.high] for r in rates]).T - value)
        at = np.arange(len(rates)) + 0.12 * (2 * k - 1)
        axis.errorbar(at, value, error, fmt=MARKERS[k], color=CYCLE[k], lw=1.2, capsize=2, label=name, clip_on=False)
    axis.set_xticks(range(len(weights)), [f"{weight:g}" for weight in weights])
    axis.set_xlabel("weight of total variation")
    axis.grid(axis="x", visible=False)
    percent_axis(axis)
    legend_above(figure)
    return figure


def _tv_words(rows: list[dict], spec: str) -> list[str]:
    words = [
        f"Trained at azimuth 0 on one body against {short_name(spec)}; the weights are on total variation divided by "
        "the number of faces, as in the reference code (the paper's bare sum freezes training)."
    ]
    for test in dict.fromkeys(row["test"] for row in rows):
        mine = [row for row in rows if row["test"] == test]
        best, none = best_row(mine), next(row for row in mine if row["tv_weight"] == 0)
        if best["tv_weight"] == 0:
            verdict = "no other weight does better"
        else:
            clear = "clearly" if best["low"] > none["success"] else "within the intervals"
            verdict = f"weight {best['tv_weight']:g} does better, {clear}: {said(best)}"
        scores = ", ".join(f"{row['mean_score']:.3f} ({row['tv_weight']:g})" for row in mine)
        words.append(
            f"On {test}: weight 0 reaches {said(none)}; {verdict}. Mean scores of the surest person, by weight: "
            f"{scores}. In the paper 0 loses at unseen angles."
        )
    return words


def _preview_figure(trained: dict[float, Trained]) -> object | None:
    """The logo in the first image of some of each weight's previews (one every 5 epochs), as training went on."""
    files = {weight: sorted((run.folder / "previews").glob("step-*.png")) for weight, run in trained.items()}
    columns = min((len(names) for names in files.values()), default=0)
    columns = min(columns, PICTURES)
    if not columns:
        return None
    figure, _ = new_figure(WIDTH, 1.15 * len(files) + 0.3)
    figure.clear()
    axes = figure.subplots(len(files), columns, squeeze=False)
    for row, (weight, names) in zip(axes, files.items(), strict=True):
        size = trained[weight].settings.size
        near = slice(round(0.19 * size), round(0.76 * size))  # of the image's height and width: where the logo moves
        spaced = np.linspace(0, len(names) - 1, columns).round().astype(int)
        for axis, name in zip(row, (names[i] for i in spaced), strict=True):
            with Image.open(name) as image:
                axis.imshow(np.asarray(image.convert("RGB"))[near, near])
            axis.set_xticks([])
            axis.set_yticks([])
            axis.grid(visible=False)
            axis.spines[:].set_visible(False)
            axis.set_title(f"step {int(name.stem.split('-')[1])}", fontsize=7, fontweight="normal")
        row[0].set_ylabel(f"weight {weight:g}")
    return figure


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
        band(axis, tuple(x for x, _ in known), [r for _, r in known], CYCLE[k], MARKERS[k], DASHES[k], name)
    percent_axis(axis)
    axis.set_xlabel("processor time of the training (s, views included)")
    axis.set_xscale("log")
    legend_above(figure)
    best = best_row(rows)
    words = [
        f"Chest + thighs against {short_name(spec)}; every cloak is tested with the renderer's default. Processor "
        "time, all threads, is shown because the clock on the wall also counts what others do on the machine.",
        f"The highest success is {said(best)}: {best['variant']}, {best['steps']} steps (the largest of {len(rows)}: "
        "differences within the intervals say nothing).",
    ]
    return Outcome("Success against cost", rows, words, {"cost": figure})
