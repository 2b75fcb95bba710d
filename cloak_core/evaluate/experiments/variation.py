"""Total variation: what its weight does, as the paper asks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from cloak_core.evaluate.experiments.attacks import SINGLE, narrow_angles, repeated
from cloak_core.evaluate.experiments.lab import Lab, Trained
from cloak_core.evaluate.experiments.logos import chest_thighs
from cloak_core.evaluate.experiments.outcome import Outcome
from cloak_core.evaluate.experiments.wording import best_row, said
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
from cloak_core.scene.pictures import read_picture

PAPER_WEIGHTS = (0.0, 0.1, 2.5, 10.0)
TV_WEIGHTS = (0.0, 0.1, 0.5, 1.0, 2.5, 10.0)
"""Of total variation: the paper's, and two between."""
PICTURES = 7
"""Previews of one training in a figure."""


def tv(lab: Lab) -> Outcome:
    """Weights of total variation: trained at azimuth 0 on one body, tested around on it and on an unseen one."""
    spec, faces, angles = lab.specs[0], chest_thighs(lab.materials.bodies), narrow_angles(lab)
    one = lab.materials.bodies.select_poses([0])
    tests = {"the trained body": one, "an unseen body": lab.materials.unseen.select_poses([0])}
    weights = PAPER_WEIGHTS if lab.options.quick else TV_WEIGHTS
    settings = lab.train_settings(angles=SINGLE)
    every = max(1, round(5 * settings.epoch_images(len(lab.materials.backgrounds)) / settings.run.batch))  # 5 epochs
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
        size = trained[weight].settings.views.size
        near = slice(round(0.19 * size), round(0.76 * size))  # of the image's height and width: where the logo moves
        spaced = np.linspace(0, len(names) - 1, columns).round().astype(int)
        for axis, name in zip(row, (names[i] for i in spaced), strict=True):
            axis.imshow(read_picture(name)[near, near])
            axis.set_xticks([])
            axis.set_yticks([])
            axis.grid(visible=False)
            axis.spines[:].set_visible(False)
            axis.set_title(f"step {int(name.stem.split('-')[1])}", fontsize=7, fontweight="normal")
        row[0].set_ylabel(f"weight {weight:g}")
    return figure
