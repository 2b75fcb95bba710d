"""Weights of total variation: trained at azimuth 0 on one body, tested around on it and on an unseen one."""

from __future__ import annotations

from cloak_core.experiments.declaration import SINGLE, Cell, Cells, Experiment, Lines, RunStore, test_angles

PAPER_WEIGHTS = (0.0, 0.1, 2.5, 10.0)
WEIGHTS = (0.0, 0.1, 0.5, 1.0, 2.5, 10.0)
"""The paper's, and two between."""


def cells(store: RunStore) -> Cells:
    first_body = store.split.bodies.select_poses([0])
    tests = {"the trained body": first_body, "an unseen body": store.split.unseen.select_poses([0])}
    training = {"bodies": first_body, "angles": SINGLE}
    for weight in PAPER_WEIGHTS if store.options.quick else WEIGHTS:
        for name, bodies in tests.items():
            yield Cell(
                label={"tv_weight": weight, "test": name},
                training={"tv_weight": weight, **training},
                # One body instead of several.
                test={"bodies": bodies, "images_per_view": 4 * store.options.test_images},
                along={"angle": test_angles(store)},
            )


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
    order=5,
)
