"""Trained in -10..10 and all around, tested at -50..50 and all around; the first detector."""

from __future__ import annotations

from matplotlib.figure import Figure

from cloak_core.evaluation.experiments.drawing import band, clothing_line, compass, look, ring
from cloak_core.evaluation.experiments.lab import MULTI, Lab
from cloak_core.evaluation.experiments.logos import chest_thighs, shirt_trousers
from cloak_core.evaluation.experiments.numbers import Numbers, column, group, select
from cloak_core.evaluation.figures import INK, SERIES, WIDTH, azimuth_axis, legend_above, new_figure, percent_axis
from cloak_core.evaluation.report.words import said, short_name

TITLE = "Wide angles and the full circle"
PAPER = [
    {"cloak": "chest + thighs, trained in ±10°", "angle": f"±{angle}", "success": success}
    for angle, success in ((10, 0.93), (50, 0.0))  # up to this angle on YOLOv2, and where the curve ends
]
CIRCLE = "0:330:30"
"""Training angles all around."""


def measure(lab: Lab) -> Numbers:
    spec, bodies = lab.specs[0], lab.materials.bodies
    tests = {
        "-50..50": tuple(float(a) for a in range(-50, 51, 10)),
        "circle": tuple(float(a) for a in range(0, 360, 20 if lab.options.quick else 15)),
    }
    # All around there is more to learn: twice the steps.
    longer = {"angles": CIRCLE, "steps": 2 * lab.steps(angles=CIRCLE)}
    kinds = {
        "chest + thighs, trained in ±10°": (chest_thighs(bodies), {"angles": MULTI}),
        "shirt + trousers, trained in ±10°": (shirt_trousers(bodies), {"angles": MULTI}),
        "shirt + trousers, trained all around": (shirt_trousers(bodies), longer),
    }
    whole, rows = [], []
    for name, (faces, changes) in kinds.items():
        trained = lab.repeat(faces, [spec], **changes)
        for test, angles in tests.items():
            result, label = lab.evaluate(trained, angles, [spec]), {"cloak": name, "test": test}
            whole.append(label | {"angle": "all"} | result.row(spec))
            rows += [label | row for row in result.rows_at(spec, "angle", angles)]
    return Numbers(whole + rows)


def tell(numbers: Numbers) -> list[str]:
    whole = select(numbers.rows, angle="all")
    words = [
        f"Tested on {short_name(whole[0]['detector'])}; the training all around has twice the steps. In the paper "
        "success decays towards 0 at ±50 degrees."
    ]
    for name, (wide, circle) in group(whole, "cloak").items():
        words.append(f"{name}: {said(wide)} over -50..50 degrees, {said(circle)} over the full circle.")
    return words


def draw(numbers: Numbers) -> dict[str, Figure]:
    figure, (axis,) = new_figure()
    around, (polar,) = new_figure(WIDTH * 0.75, 4.2, subplot_kw={"projection": "polar"})
    cloaks = group([row for row in numbers.rows if row["angle"] != "all"], "cloak")
    for k, (name, rows) in enumerate(cloaks.items()):
        wide, circle = select(rows, test="-50..50"), select(rows, test="circle")
        band(axis, column(wide, "angle"), wide, name, alpha=0.1, **look(k))
        # On a circle only one band can be read.
        ring(polar, circle, "success", look(k)["color"], look(k)["ls"], name, banded=k == len(cloaks) - 1)
    clothing_line(axis, column(wide, "angle"), wide)
    ring(polar, circle, "clothing", INK, ":", SERIES["clothing"].label)
    percent_axis(axis)
    azimuth_axis(axis)
    legend_above(figure)
    compass(polar)
    around.legend(*polar.get_legend_handles_labels(), loc="outside upper left")
    return {"wide": figure, "circle": around}
