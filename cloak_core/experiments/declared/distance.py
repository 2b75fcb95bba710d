"""Trained at 2.2 m or at distances drawn from 1.4..3.0, tested over distances and angles; the first detector."""

from __future__ import annotations

from cloak_core.experiments.declaration import SINGLE, Cell, Cells, Experiment, Lines, RunStore

TRAINED = {"trained at 2.2 m": "2.2", "trained at 1.4 to 3.0 m": "1.4:3.0"}
DISTANCES = tuple(round(1.4 + 0.2 * k, 1) for k in range(9))
FIVE_DISTANCES = (1.4, 1.8, 2.2, 2.6, 3.0)


def cells(store: RunStore) -> Cells:
    quick = store.options.quick
    near = DISTANCES[::2] if quick else DISTANCES
    angles = tuple(float(a) for a in range(-10, 11, 10 if quick else 1))
    for name, drawn in TRAINED.items():
        training = {"angles": SINGLE, "distance": drawn}
        yield Cell(
            label={"cloak": name, "test": "distances"},
            angles=(0.0,),
            test={"distances": near, "images_per_view": 2 * store.options.test_images},
            along={"distance": near},
            training=training,
        )
        yield Cell(
            label={"cloak": name, "test": "angles"},
            angles=angles,
            test={"distances": FIVE_DISTANCES},
            along={"distance": FIVE_DISTANCES, "angle": angles},
            training=training,
        )


EXPERIMENT = Experiment(
    title="Distance (appendix A)",
    caption="Single-angle training (azimuth 0) against the first detector, as in the paper's appendix A; where "
    "distances are drawn, every image has its own (the paper draws one per batch).",
    cells=cells,
    figures={
        "distance": Lines(x="distance", series="cloak", where={"test": "distances"}, clothing=True),
        "angles": Lines(
            x="angle", series="distance", panel="cloak", where={"test": "angles"}, label="{} m", interval=""
        ),
    },
    order=6,
)
