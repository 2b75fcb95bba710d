"""Trained in -10..10 and all around, tested at -50..50 and all around; the first detector."""

from __future__ import annotations

from cloak_core.core.logo import chest_thighs, shirt_trousers
from cloak_core.experiments.declaration import MULTI, Cell, Cells, Experiment, Lines, Rings, RunStore

CIRCLE = "0:330:30"
"""Training angles all around."""


def cells(store: RunStore) -> Cells:
    bodies = store.split.bodies
    tests = {
        "-50..50": tuple(float(a) for a in range(-50, 51, 10)),
        "circle": tuple(float(a) for a in range(0, 360, 20 if store.options.quick else 15)),
    }
    # All around there is more to learn: twice the steps.
    longer = {"angles": CIRCLE, "steps": 2 * store.steps(angles=CIRCLE)}
    cloaks = {
        "chest + thighs, trained in ±10°": (chest_thighs(bodies), {"angles": MULTI}),
        "shirt + trousers, trained in ±10°": (shirt_trousers(bodies), {"angles": MULTI}),
        "shirt + trousers, trained all around": (shirt_trousers(bodies), longer),
    }
    for name, (faces, training) in cloaks.items():
        for test, angles in tests.items():
            yield Cell(
                label={"cloak": name, "test": test},
                faces=faces,
                training=training,
                angles=angles,
                along={"angle": angles},
            )


EXPERIMENT = Experiment(
    title="Wide angles and the full circle",
    caption="Three cloaks against the first detector, tested over -50..50 degrees and over the full circle; the "
    "training all around has twice the steps. In the paper success decays towards 0 at ±50 degrees.",
    cells=cells,
    figures={
        "wide": Lines(x="angle", series="cloak", where={"test": "-50..50"}, clothing=True),
        "circle": Rings(series="cloak", where={"test": "circle"}),
    },
    # Up to this angle on YOLOv2, and where the curve ends.
    paper=tuple(
        {"cloak": "chest + thighs, trained in ±10°", "angle": f"±{angle}", "success": success}
        for angle, success in ((10, 0.93), (50, 0.0))
    ),
    order=3,
)
