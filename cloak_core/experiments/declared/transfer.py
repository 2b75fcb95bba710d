"""Transfer: chest + thighs trained against each detector, tested on all of them."""

from __future__ import annotations

from cloak_core.experiments.declaration import MULTI, Cell, Cells, Experiment, Matrix, RunStore


def cells(store: RunStore) -> Cells:
    for source in store.specs:
        yield Cell(
            label={"trained_on": source},
            specs=[source],
            training={"angles": MULTI},
            judges=store.specs,
            judge_column="tested_on",
        )


EXPERIMENT = Experiment(
    title="Transfer between detectors",
    caption="Chest + thighs is trained at five angles against each detector and shown to every other (black box). "
    "With a single detector there is no transfer: name several with --detector.",
    cells=cells,
    figures={"matrix": Matrix()},
    order=4,
)
