"""White box: each detector's own cloaks, at the paper's threshold and at the detector's own operating point."""

from __future__ import annotations

from cloak_core.core.evaluation.controls import STANDARD
from cloak_core.core.logo import chest_thighs, shirt_trousers
from cloak_core.experiments.declaration import MULTI, Bars, Cell, Cells, Experiment, RunStore

IMAGES_PER_VIEW = 4
"""With four unseen bodies at 21 angles: 336 images."""
COLUMNS = ("operating_point", "success_own", "own_low", "own_high", "clothing", "clothing_own", "grey", "grey_own")
COLUMNS += ("random", "random_own", "ap50", "clean_ap50", "false_alarms_own", "seeds")


def images(store: RunStore) -> dict:
    """Count the images of each unseen body at each azimuth."""
    return {"images_per_view": store.options.images_per_view or (2 if store.options.quick else IMAGES_PER_VIEW)}


def cells(store: RunStore) -> Cells:
    bodies = store.split.bodies
    for spec in store.specs:
        steps = store.steps([spec], angles=MULTI)
        for logo, faces in (("shirt + trousers", shirt_trousers(bodies)), ("chest + thighs", chest_thighs(bodies))):
            yield Cell(
                label={"detector": spec, "logo": logo, "steps": steps},
                faces=faces,
                area=True,
                specs=[spec],
                training={"angles": MULTI},
                test={"controls": STANDARD} | images(store),
                columns=COLUMNS,
                timed=True,
            )


EXPERIMENT = Experiment(
    title="White box on each detector, at 0.6 and at its own operating point",
    caption="Each logo is trained at five angles and judged on unseen bodies and photographs at azimuths in -10..10. "
    "Success: no person box above the threshold anywhere in the image, at the paper's 0.6 and at the confidence at "
    "which the detector is usually run. Own clothing: what the clean detector misses.",
    cells=cells,
    figures={"success": Bars(y="detector", panel="logo", own=True)},
    facts={"training_angles": MULTI},
    counts=images,
    order=12,
)
