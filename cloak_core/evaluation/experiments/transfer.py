"""Transfer: chest + thighs trained against each detector, tested on all of them."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.experiments.lab import MULTI, Lab
from cloak_core.evaluation.experiments.numbers import Numbers, Rows, best_row, column, group
from cloak_core.evaluation.figures import SERIES, new_figure
from cloak_core.evaluation.report.words import percent, short_name

TITLE = "Transfer between detectors"


def measure(lab: Lab) -> Numbers:
    rows = []
    for source in lab.specs:
        result = lab.evaluate(lab.chest_thighs(source, angles=MULTI), lab.angles)
        for target in lab.specs:
            row = result.row(target)
            rows.append({"trained_on": source, "tested_on": row.pop("detector")} | row)
    return Numbers(rows, {"steps": {spec: lab.steps([spec]) for spec in lab.specs}})


def tell(numbers: Numbers) -> list[str]:
    lengths = ", ".join(f"{short_name(spec)} ({steps} steps)" for spec, steps in numbers.facts["steps"].items())
    words = [
        f"Chest + thighs was trained at five angles against each of {lengths} and shown to every other (black box)."
    ]
    off = _between(numbers.rows)
    if not off:
        return [
            *words,
            "Only one detector was given, so there is no transfer to speak of: name several with --detector.",
        ]
    best = best_row(off)
    words.append(
        f"Between different detectors success lies between {percent(min(column(off)))} and {percent(best['success'])} "
        f"(from {short_name(best['trained_on'])} to {short_name(best['tested_on'])})."
    )
    return words


def draw(numbers: Numbers) -> dict[str, Figure]:
    return {"matrix": _matrix_figure(numbers.rows)} if _between(numbers.rows) else {}


def _between(rows: Rows) -> Rows:
    return [row for row in rows if row["trained_on"] != row["tested_on"]]


def _matrix_figure(rows: Rows) -> Figure:
    """Success by detector trained on and tested on; below it what the same images say of two controls."""
    by_source = group(rows, "trained_on")
    names = [short_name(spec).replace(" ", "\n") for spec in by_source]
    controls = ("random", CLOTHING)  # they wear nothing trained: alike under every source
    tested = next(iter(by_source.values()))
    shown = np.array([column(mine) for mine in by_source.values()] + [column(tested, c) for c in controls])
    figure, (axis,) = new_figure(2.6 + 0.9 * len(names), 1.3 + 0.6 * len(shown))
    image = axis.imshow(shown, cmap="cividis", vmin=0, vmax=1, aspect="auto")
    axis.grid(visible=False)
    for (i, j), value in np.ndenumerate(shown):
        axis.text(j, i, f"{100 * value:.0f}", ha="center", va="center", color="black" if value > 0.55 else "white")
    axis.axhline(len(names) - 0.5, color="white", lw=3)
    axis.set_xticks(range(len(names)), names, rotation=30, ha="right", rotation_mode="anchor")
    axis.set_yticks(range(len(shown)), names + [SERIES[control].label for control in controls])
    axis.set_xlabel("tested on")
    axis.set_ylabel("trained on")
    figure.colorbar(image, ax=axis, shrink=0.8, label="attack success", format=lambda v, _: f"{100 * v:.0f} %")
    return figure
