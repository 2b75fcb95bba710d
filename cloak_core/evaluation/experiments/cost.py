"""Success against training time: samples per pixel, the detector's precision, views kept or made for each image."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from cloak_core.evaluation.experiments.drawing import errors, look
from cloak_core.evaluation.experiments.lab import MULTI, Lab, times
from cloak_core.evaluation.experiments.numbers import Numbers, best_row, column, group
from cloak_core.evaluation.figures import legend_above, new_figure, percent_axis
from cloak_core.evaluation.report.words import said, short_name

TITLE = "Success against cost"
VARIANTS: dict[str, dict[str, object]] = {
    "exact area, float32, views kept": {},
    "1 sample per pixel": {"samples": 1},
    "detector in bfloat16": {"precision": "bfloat16"},
    "a new view for every image": {"angle_jitter": 2.5},
    "4 samples per pixel": {"samples": 4},
    "16 samples per pixel": {"samples": 16},
    "64 samples per pixel": {"samples": 64},
}
"""What a training can save on; each changes the first."""
QUICK = 4
"""So many of them when quick."""


def measure(lab: Lab) -> Numbers:
    spec, full, rows = lab.specs[0], lab.steps(angles=MULTI), []
    lengths = sorted({max(1, full // share) for share in ((3, 1) if lab.options.quick else (4, 2, 1))})
    for name, changes in list(VARIANTS.items())[: QUICK if lab.options.quick else None]:
        for steps in lengths:
            trained = lab.chest_thighs(spec, angles=MULTI, steps=steps, **changes)
            label = {"variant": name, "steps": steps}
            rows.append(label | times(trained) | lab.evaluate(trained, lab.angles, [spec]).row(spec))
    return Numbers(rows)


def tell(numbers: Numbers) -> list[str]:
    best = best_row(numbers.rows)
    return [
        f"Chest + thighs against {short_name(best['detector'])}; every cloak is tested with the renderer's default. "
        "Processor time, all threads, is shown because the clock on the wall also counts what others do on the "
        "machine.",
        f"The highest success is {said(best)}: {best['variant']}, {best['steps']} steps (the largest of "
        f"{len(numbers.rows)}: differences within the intervals say nothing).",
    ]


def draw(numbers: Numbers) -> dict[str, Figure]:
    figure, (axis,) = new_figure()
    for k, (name, rows) in enumerate(group(numbers.rows, "variant").items()):
        rows = [row for row in rows if row["cpu_seconds"] is not None]
        bars = {"lw": 1.4, "capsize": 2, "elinewidth": 0.8} | look(k)
        axis.errorbar(column(rows, "cpu_seconds"), column(rows), errors(rows), label=name, clip_on=False, **bars)
    percent_axis(axis)
    axis.set_xlabel("processor time of the training (s, views included)")
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter(LogFormatter())
    axis.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
    legend_above(figure)
    return {"cost": figure}
