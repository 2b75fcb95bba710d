"""How much a shirt must change: success against closeness to a camouflage print, white box and black box."""

from __future__ import annotations

from PIL import Image

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.controls import LOGO
from cloak_core.experiments.declaration import Cell, Cells, Experiment, Lines, RunStore, Trainings
from cloak_core.experiments.sheets import draw_sheet, trial_cells
from cloak_core.scene.logos.garments import shirt_trousers

FREE = 100.0
"""Mean CIEDE2000 that no colours have from each other: no bound."""
WITHIN = (0.0, 5.0, 10.0, 20.0, 40.0, FREE)
CIRCLE = "0:315:45"
"""Azimuths of training and test, degrees."""
COLUMNS = ("operating_point", "success_own", "own_low", "own_high", "clothing", "clothing_own", "seeds")
SIDE = 208
"""Of a picture of the strip, pixels."""


def cells(store: RunStore) -> Cells:
    judge, *others = store.specs
    photographs = store.split.people is not None
    for attack, specs, preset in (("white box", [judge], "best"), ("black box", others, "transfer")):
        for within in WITHIN if specs else ():
            # The print itself is no training: its colours may not move.
            near = {"within": within} if within else {"within": 0.001, "steps": 1}
            where = {"preset": "photographs"} if photographs else {"preset": preset, "angles": CIRCLE}
            yield Cell(
                label={"attack": attack, "within": within},
                faces=shirt_trousers(store.split.bodies),
                specs=specs,
                training={"near": "camouflage"} | where | near,
                judges=[judge],
                angles=tuple(float(a) for a in range(0, 360, 45)),
                columns=COLUMNS,
            )


def pictures(store: RunStore, trainings: Trainings) -> dict[str, Image.Image]:
    """Draw the same trial in each cloak of the first repetition, a row for each attack."""
    detector, settings, rows = store.split.detectors[store.specs[0]], store.evaluate_settings(), {}
    for cell, (trained, *_) in trainings:
        if store.split.unseen_people is None:
            renderer = store.renderer(trained, cell.angles, settings)
        else:
            renderer = store.people_renderer(trained, settings)
        shown = trial_cells(renderer, 0, (LOGO,), detector, THRESHOLD, SIDE)
        rows.setdefault(cell.label["attack"], []).extend(shown)
    return {"strip": draw_sheet([f"{w:g}" if w < FREE else "free" for w in WITHIN], list(rows.items()), SIDE)}


EXPERIMENT = Experiment(
    title="Closeness to what people wear",
    caption="Shirt and trousers may differ from a woodland print by this mean CIEDE2000 (and by twice that at the 95th "
    "percentile); 0 is the print itself, 100 no bound. White box: trained against the first detector. Black box: "
    "trained against the others. The first detector judges: unseen bodies all around, or people in photographs.",
    cells=cells,
    figures={
        "closeness": Lines(x="within", series="attack", even=True, interval="bars"),
        "own": Lines(x="within", y="success_own", series="attack", even=True, interval=""),
    },
    pictures=pictures,
    order=13,
)
