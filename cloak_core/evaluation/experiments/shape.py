"""Success against logo area for a family of shapes; the first detector."""

from __future__ import annotations

from matplotlib.figure import Figure

from cloak_core.evaluation.experiments.drawing import errors, look
from cloak_core.evaluation.experiments.lab import MULTI, Lab
from cloak_core.evaluation.experiments.logos import shapes
from cloak_core.evaluation.experiments.numbers import Numbers, column, group
from cloak_core.evaluation.figures import legend_above, new_figure, percent_axis
from cloak_core.evaluation.report.words import percent, said, short_name
from cloak_core.scene.logos.logo import area_share

TITLE = "Success by shape and area"


def measure(lab: Lab) -> Numbers:
    spec, bodies, rows = lab.specs[0], lab.materials.bodies, []
    for name, faces in shapes(bodies, lab.options.out / "shape", lab.options.quick).items():
        result = lab.evaluate(lab.repeat(faces, [spec], angles=MULTI), lab.angles, [spec])
        label = {"shape": name.rpartition(" ")[0], "area_share": round(area_share(bodies, faces), 4)}
        rows.append(label | result.row(spec))
    return Numbers(rows)


def tell(numbers: Numbers) -> list[str]:
    rows = sorted(numbers.rows, key=lambda row: row["area_share"])
    smallest, largest = rows[0], rows[-1]
    return [
        "Shapes stamped on the chest at growing size, trained at five angles against "
        f"{short_name(smallest['detector'])}.",
        f"The smallest ({percent(smallest['area_share'])} of the area) reaches {said(smallest)}, the largest "
        f"{said(largest)}.",
    ]


def draw(numbers: Numbers) -> dict[str, Figure]:
    figure, (axis,) = new_figure()
    for k, (family, rows) in enumerate(group(numbers.rows, "shape").items()):
        rows = sorted(rows, key=lambda row: row["area_share"])
        area = [100 * share for share in column(rows, "area_share")]
        axis.errorbar(area, column(rows), errors(rows), lw=1.4, capsize=2, label=family, **look(k))
    percent_axis(axis)
    axis.set_xlabel("share of the body's area (%)")
    legend_above(figure)
    return {"area": figure}
