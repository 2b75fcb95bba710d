"""How much a shirt must change: success against closeness to a camouflage print, white box and black box."""

from __future__ import annotations

import torch
from PIL import Image, ImageDraw, ImageOps

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.logo import shirt_trousers
from cloak_core.experiments.declaration import Cell, Cells, Experiment, Lines, RunStore, Trainings
from cloak_core.studies.report.pictures import font, reported, to_pil

FREE = 100.0
"""Mean CIEDE2000 that no colours have from each other: no bound."""
WITHIN = (0.0, 5.0, 10.0, 20.0, 40.0, FREE)
CIRCLE = "0:315:45"
"""Azimuths of training and test, degrees."""
LINE = 18
"""Pixels below a picture, for what is reported on it."""
COLUMNS = ("operating_point", "success_own", "own_low", "own_high", "clothing", "clothing_own", "seeds")


def cells(store: RunStore) -> Cells:
    judge, *others = store.specs
    people = store.split.people
    for attack, specs, preset in (("white box", [judge], "best"), ("black box", others, "transfer")):
        for within in WITHIN if specs else ():
            # The print itself is no training: its colours may not move.
            near = {"within": within} if within else {"within": 0.001, "steps": 1}
            where = {"preset": people.preset(preset)} | ({} if people else {"angles": CIRCLE})
            yield Cell(
                label={"attack": attack, "within": within},
                faces=shirt_trousers(store.split.bodies),
                specs=specs,
                training={"near": "camouflage"} | where | near,
                judges=[judge],
                angles=tuple(float(a) for a in range(0, 360, 45)),
                columns=COLUMNS,
            )


@torch.no_grad()
def pictures(store: RunStore, trainings: Trainings) -> dict[str, Image.Image]:
    """Draw the same trial in each cloak of the first repetition, a row for each attack, with what is reported."""
    detector = store.split.detectors[store.specs[0]]
    rows: dict[str, list[Image.Image]] = {}
    for cell, (trained, *_) in trainings:
        images, _ = store.shown(trained.pattern, cell.angles, store.evaluate_settings())
        image = images.render([0], trained.pattern)
        report = reported(image, {"": detector}, THRESHOLD)
        boxes, score = report["boxes"][""], report["scores"][""]
        picture = to_pil(image[0])
        for *box, _ in boxes:
            ImageDraw.Draw(picture).rectangle(box, outline="#e0341c", width=2)
        within = f"{cell.label['within']:g}" if cell.label["within"] < FREE else "free"
        found = f"person {score:.2f}" if boxes else f"no person (best {score:.2f})"
        whole = ImageOps.expand(picture, (0, 0, 0, LINE), "white")
        words = f"{cell.label['attack']}, {within}: {found}"
        ImageDraw.Draw(whole).text((2, picture.height), words, "black", font(LINE * 2 // 3))
        rows.setdefault(cell.label["attack"], []).append(whole)
    width, height = whole.size
    strip = Image.new("RGB", (width * max(map(len, rows.values())), height * len(rows)), "white")
    for row, shown in enumerate(rows.values()):
        for column, picture in enumerate(shown):
            strip.paste(picture, (column * width, row * height))
    return {"strip": strip}


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
