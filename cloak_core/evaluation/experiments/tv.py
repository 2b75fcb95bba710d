"""Weights of total variation: trained at azimuth 0 on one body, tested around on it and on an unseen one."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from cloak_core.evaluation.contact_sheet import Cell, draw_sheet
from cloak_core.evaluation.experiments.drawing import angle_panels, errors
from cloak_core.evaluation.experiments.lab import SINGLE, Lab
from cloak_core.evaluation.experiments.numbers import Numbers, Rows, best_row, column, group, select
from cloak_core.evaluation.figures import CYCLE, MARKERS, legend_above, new_figure, percent_axis
from cloak_core.evaluation.report.words import said, short_name
from cloak_core.scene.pictures import read_picture

TITLE = "Total variation"
PAPER_WEIGHTS = (0.0, 0.1, 2.5, 10.0)
WEIGHTS = (0.0, 0.1, 0.5, 1.0, 2.5, 10.0)
"""The paper's, and two between."""
PICTURES, SIDE = 7, 160
"""Previews of one training on the sheet, and their width in pixels."""


def measure(lab: Lab) -> Numbers:
    spec, one = lab.specs[0], lab.materials.bodies.select_poses([0])
    tests = {"the trained body": one, "an unseen body": lab.materials.unseen.select_poses([0])}
    settings = lab.train_settings(angles=SINGLE)
    every = max(1, round(5 * settings.epoch_images(len(lab.materials.backgrounds)) / settings.run.batch))  # 5 epochs
    changes = {"bodies": one, "angles": SINGLE, "preview_every": every}
    images = 4 * lab.options.test_images  # one body instead of several
    whole, rows, first = [], [], {}
    for weight in PAPER_WEIGHTS if lab.options.quick else WEIGHTS:
        trained = lab.chest_thighs(spec, tv_weight=weight, **changes)
        first[weight] = trained[0]
        for name, bodies in tests.items():
            result = lab.evaluate(trained, lab.angles, [spec], bodies=bodies, images_per_view=images)
            label = {"tv_weight": weight, "test": name}
            whole.append(label | {"angle": "all"} | result.row(spec))
            rows += [label | row for row in result.rows_at(spec, "angle", lab.angles)]
    return Numbers(whole + rows, pictures=preview_sheet(first))


def tell(numbers: Numbers) -> list[str]:
    whole = select(numbers.rows, angle="all")
    words = [
        f"Trained at azimuth 0 on one body against {short_name(whole[0]['detector'])}; the weights are on total "
        "variation divided by the number of faces, as in the reference code (the paper's bare sum freezes training)."
    ]
    for test, mine in group(whole, "test").items():
        best, none = best_row(mine), select(mine, tv_weight=0)[0]
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


def draw(numbers: Numbers) -> dict[str, Figure]:
    rows = [row for row in numbers.rows if row["angle"] != "all"]
    return {
        "weights": _weight_figure(select(numbers.rows, angle="all")),
        "angles": angle_panels(rows, "test", "tv_weight", "weight {:g}"),
    }


def _weight_figure(whole: Rows) -> Figure:
    """Success over all angles with its interval against the weight, a series for each test."""
    figure, (axis,) = new_figure()
    for k, (name, rows) in enumerate(group(whole, "test").items()):
        at = np.arange(len(rows)) + 0.12 * (2 * k - 1)
        series = {"fmt": MARKERS[k], "color": CYCLE[k], "label": name}
        axis.errorbar(at, column(rows), errors(rows), lw=1.2, capsize=2, clip_on=False, **series)
    axis.set_xticks(range(len(rows)), [f"{weight:g}" for weight in column(rows, "tv_weight")])
    axis.set_xlabel("weight of total variation")
    axis.grid(axis="x", visible=False)
    percent_axis(axis)
    legend_above(figure)
    return figure


def preview_sheet(trained: dict) -> dict[str, Image.Image]:
    """The logo in the first image of some of each weight's previews (one every 5 epochs), as training went on."""
    rows = []
    for weight, run in trained.items():
        files = sorted((run.folder / "previews").glob("step-*.png"))
        size, cells = run.settings.views.size, []
        near = tuple(round(share * size) for share in (0.19, 0.19, 0.76, 0.76))  # where the logo moves
        for k in np.linspace(0, len(files) - 1, min(len(files), PICTURES)).round().astype(int):
            image = Image.fromarray(read_picture(files[k])).crop(near).resize((SIDE, SIDE))
            cells.append(Cell(image, f"step {int(files[k].stem.split('-')[1])}"))
        rows.append((f"weight {weight:g}", cells))
    columns = min(len(cells) for _, cells in rows)
    return {"pictures-logos": draw_sheet([""] * columns, rows, SIDE)} if columns else {}
