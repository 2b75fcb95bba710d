"""Trained at azimuth 0 alone, tested at every whole degree around it."""

from __future__ import annotations

from cloak_core.experiments.declaration import SINGLE, Cell, Cells, Experiment, Lines, RunStore, test_angles
from cloak_core.experiments.declared import table1


def cells(store: RunStore) -> Cells:
    for spec in store.specs:
        yield Cell(label={}, specs=[spec], training={"angles": SINGLE}, along={"angle": test_angles(store)})


EXPERIMENT = Experiment(
    title="Trained at one angle, tested at unseen ones",
    caption="Chest + thighs is trained at azimuth 0 alone and tested at unseen angles around it.",
    cells=cells,
    figures={"angles": Lines(x="angle", series="detector", clothing=True)},
    paper=tuple(
        {"detector": row["detector"], "success": row["single"]}
        for row in table1.PAPER
        if row["logo"] == "chest + thighs"
    ),
    order=2,
)
