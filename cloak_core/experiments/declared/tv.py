"""Weights of total variation: trained at azimuth 0 on one body, tested around on it and on an unseen one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from cloak_core.experiments.declaration import SINGLE, Cell, Cells, Experiment, Lines, RunStore, Trainings, test_angles
from cloak_core.experiments.sheets import Picture, draw_sheet
from cloak_core.scene.pictures import read_picture

PAPER_WEIGHTS = (0.0, 0.1, 2.5, 10.0)
WEIGHTS = (0.0, 0.1, 0.5, 1.0, 2.5, 10.0)
"""The paper's, and two between."""
PICTURES = 7
"""Previews of one training on the sheet."""


def cells(store: RunStore) -> Cells:
    one = store.split.bodies.select_poses([0])
    tests = {"the trained body": one, "an unseen body": store.split.unseen.select_poses([0])}
    settings = store.train_settings(angles=SINGLE)
    epoch = settings.epoch_images(len(store.split.backgrounds)) / settings.run.batch
    training = {"bodies": one, "angles": SINGLE, "preview_every": max(1, round(5 * epoch))}
    for weight in PAPER_WEIGHTS if store.options.quick else WEIGHTS:
        for name, bodies in tests.items():
            yield Cell(
                label={"tv_weight": weight, "test": name},
                training={"tv_weight": weight, **training},
                # One body instead of several.
                test={"bodies": bodies, "images_per_view": 4 * store.options.test_images},
                along={"angle": test_angles(store)},
            )


def pictures(store: RunStore, trainings: Trainings) -> dict[str, Image.Image]:
    """Show the logo in previews of each weight's first training, a row each."""
    size = store.options.size
    rows = {f"weight {cell.label['tv_weight']:g}": previews(trained[0].folder, size) for cell, trained in trainings}
    return {"pictures-logos": draw_sheet(rows)} if all(rows.values()) else {}


def previews(run: Path, size: int) -> list[Picture]:
    """Cut the logo out of the first image of some of a run's previews, evenly spaced; size: of that image, pixels."""
    files = sorted((run / "previews").glob("step-*.png"))
    near = tuple(round(share * size) for share in (0.19, 0.19, 0.76, 0.76))  # where the logo moves
    shown = np.linspace(0, len(files) - 1, min(len(files), PICTURES)).round().astype(int)
    cut = lambda file: Image.fromarray(read_picture(file)).crop(near)
    return [Picture(cut(files[k]), f"step {int(files[k].stem.split('-')[1])}") for k in shown]


EXPERIMENT = Experiment(
    title="Total variation",
    caption="Trained at azimuth 0 on one body against the first detector. Weights are on total variation divided by "
    "the number of faces, as in the reference code: the paper's bare sum freezes training. In the paper weight 0 "
    "loses at unseen angles. Mean score: of the surest person, where less is better.",
    cells=cells,
    figures={
        "weights": Lines(x="tv_weight", series="test", where={"angle": "all"}, interval="bars", even=True),
        "angles": Lines(x="angle", series="tv_weight", panel="test", label="weight {:g}", interval=""),
    },
    pictures=pictures,
    order=5,
)
