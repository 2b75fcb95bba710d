"""Trained at azimuth 0 alone, tested at every whole degree around it."""

from __future__ import annotations

from matplotlib.figure import Figure

from cloak_core.evaluation.experiments import table1
from cloak_core.evaluation.experiments.drawing import band, clothing_line, look
from cloak_core.evaluation.experiments.lab import SINGLE, Lab
from cloak_core.evaluation.experiments.numbers import Numbers, column, group, select
from cloak_core.evaluation.figures import azimuth_axis, legend_above, new_figure, percent_axis
from cloak_core.evaluation.report.words import percent, said, short_name

TITLE = "Trained at one angle, tested at unseen ones"
PAPER = [
    {"detector": row["detector"], "success": row["single"]} for row in table1.PAPER if row["logo"] == "chest + thighs"
]


def measure(lab: Lab) -> Numbers:
    whole, rows = [], []
    for spec in lab.specs:
        trained = lab.chest_thighs(spec, angles=SINGLE)
        result = lab.evaluate(trained, lab.angles, [spec])
        whole.append({"angle": "all"} | result.row(spec))
        rows += result.rows_at(spec, "angle", lab.angles)
    return Numbers(whole + rows)


def tell(numbers: Numbers) -> list[str]:
    words = ["Chest + thighs was trained at azimuth 0 alone and tested at unseen angles around it."]
    for spec, rows in group(numbers.rows, "detector").items():
        whole = select(rows, angle="all")[0]
        at = {angle: percent(select(rows, angle=angle)[0]["success"]) for angle in (0, -10, 10)}
        words.append(
            f"{short_name(spec)}: {said(whole)} over all angles, {at[0]} at 0, {at[-10]} at -10 and {at[10]} at 10 "
            f"degrees; own clothing {percent(whole['clothing'])}."
        )
    return words


def draw(numbers: Numbers) -> dict[str, Figure]:
    figure, (axis,) = new_figure()
    for k, (spec, rows) in enumerate(group(numbers.rows, "detector").items()):
        rows = [row for row in rows if row["angle"] != "all"]
        band(axis, column(rows, "angle"), rows, short_name(spec), **look(k))
        if not k:
            clothing_line(axis, column(rows, "angle"), rows)
    percent_axis(axis)
    azimuth_axis(axis)
    legend_above(figure)
    return {"angles": figure}
