"""Trained at 2.2 m or at distances drawn from 1.4..3.0, tested over distances and angles; the first detector."""

from __future__ import annotations

from matplotlib.figure import Figure

from cloak_core.evaluation.experiments.drawing import angle_panels, band, clothing_line, look
from cloak_core.evaluation.experiments.lab import SINGLE, Lab
from cloak_core.evaluation.experiments.numbers import Numbers, Rows, column, group, select
from cloak_core.evaluation.figures import SERIES, legend_above, new_figure, percent_axis
from cloak_core.evaluation.report.words import said, short_name

TITLE = "Distance (appendix A)"
TRAINED = {"trained at 2.2 m": "2.2", "trained at 1.4 to 3.0 m": "1.4:3.0"}
DISTANCES = tuple(round(1.4 + 0.2 * k, 1) for k in range(9))
FIVE_DISTANCES = (1.4, 1.8, 2.2, 2.6, 3.0)


def measure(lab: Lab) -> Numbers:
    spec, quick = lab.specs[0], lab.options.quick
    near = DISTANCES[::2] if quick else DISTANCES
    angles = tuple(float(a) for a in range(-10, 11, 10 if quick else 1))
    whole, rows = [], []
    for name, drawn in TRAINED.items():
        trained = lab.chest_thighs(spec, angles=SINGLE, distance=drawn)
        images = 2 * lab.options.test_images
        result = lab.evaluate(trained, (0.0,), [spec], distances=near, images_per_view=images)
        turned = lab.evaluate(trained, angles, [spec], distances=FIVE_DISTANCES)
        label = {"cloak": name, "test": "distances"}
        whole.append(label | {"distance": "all"} | result.row(spec))
        rows += [label | row for row in result.rows_at(spec, "distance", near)]
        label = {"cloak": name, "test": "angles"}
        whole.append(label | {"distance": "all"} | turned.row(spec))
        for d in FIVE_DISTANCES:
            rows += [label | {"distance": d} | row for row in turned.rows_at(spec, "angle", angles, distance=d)]
    return Numbers(whole + rows)


def tell(numbers: Numbers) -> list[str]:
    whole = select(numbers.rows, distance="all")
    words = [
        f"Single-angle training (azimuth 0) against {short_name(whole[0]['detector'])}, as in the paper's appendix A; "
        "where distances are drawn, every image has its own (the paper draws one per batch)."
    ]
    for name, (over_distances, over_angles) in group(whole, "cloak").items():
        words.append(f"{name}: {said(over_distances)} over the distances, {said(over_angles)} over angles.")
    return words


def draw(numbers: Numbers) -> dict[str, Figure]:
    rows = [row for row in numbers.rows if row["distance"] != "all"]
    return {
        "distance": _distance_figure(group(select(rows, test="distances"), "cloak")),
        "angles": angle_panels(select(rows, test="angles"), "cloak", "distance", "{} m"),
    }


def _distance_figure(cloaks: dict[str, Rows]) -> Figure:
    figure, (axis,) = new_figure()
    for k, (name, rows) in enumerate(cloaks.items()):
        # Blue and green: own clothing is orange.
        band(axis, column(rows, "distance"), rows, name, **look(k) | {"color": look(2 * k)["color"]})
    first = next(iter(cloaks.values()))
    clothing_line(axis, column(first, "distance"), first, SERIES["clothing"].color)
    percent_axis(axis)
    axis.set_xlabel("distance (m)")
    legend_above(figure)
    return figure
