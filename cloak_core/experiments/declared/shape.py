"""Success against logo area for a family of shapes; the first detector."""

from __future__ import annotations

from cloak_core.experiments.declaration import MULTI, Cell, Cells, Experiment, Lines, RunStore
from cloak_core.experiments.logos import shapes


def cells(store: RunStore) -> Cells:
    bodies = store.split.bodies
    for name, faces in shapes(bodies, store.options.out / "shape", store.options.quick).items():
        yield Cell(label={"shape": name.rpartition(" ")[0]}, faces=faces, area=True, training={"angles": MULTI})


EXPERIMENT = Experiment(
    title="Success by shape and area",
    caption="Shapes stamped on the chest at growing size, and chest + thighs, trained at five angles against the "
    "first detector.",
    cells=cells,
    figures={"area": Lines(x="area_share", series="shape", interval="bars")},
    order=7,
)
