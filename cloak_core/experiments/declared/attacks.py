"""What training's choices are worth, and what colours must keep: on each detector itself, and black box."""

from __future__ import annotations

import torch
from PIL import Image, ImageDraw, ImageOps

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.evaluation import STANDARD
from cloak_core.core.logo import chest_thighs, shirt_trousers
from cloak_core.experiments.declaration import (
    MULTI,
    SINGLE,
    Bars,
    Cell,
    Cells,
    Experiment,
    Lines,
    RunStore,
    Trainings,
)
from cloak_core.studies.report.pictures import font, reported, to_pil

# --- the choices behind preset `best`: the same with one of them changed; the first detector

CHANGES: dict[str, dict[str, object]] = {
    "preset best": {},
    "SGD instead of Adam": {"optimizer": "sgd", "lr": 1.0, "momentum": 0.9},
    "learning rate 0.02 instead of 0.05": {"lr": 0.02},
    "learning rate 0.1 instead of 0.05": {"lr": 0.1},
    "constant learning rate": {"schedule": "constant"},
    "loss: score": {"loss": "score"},
    "loss: objectness": {"loss": "objectness"},
    "loss: log": {"loss": "log"},
    "no total variation": {"tv_weight": 0.0},
    "no photometric noise": {"contrast": "1", "brightness": "0", "noise": 0.0},
    "the paper's photometric range": {"contrast": "0:1", "brightness": "0:1"},
    "no translation": {"translation": 0},
    "one angle": {"angles": SINGLE},
    "from random colours": {"initial": "random"},
    "sigmoid instead of projection": {"gamut": "sigmoid"},
}
"""Each changes one choice of preset `best`."""
NOT_QUICK = ("constant learning rate", "loss: objectness", "the paper's photometric range")
NOT_QUICK += ("no translation", "from random colours", "sigmoid instead of projection")
"""Left out when quick."""


ABLATION = Experiment(
    title="The choices behind preset best",
    caption="Chest + thighs against the first detector. Each row changes one choice of preset best, with the same "
    "number of steps. Differences within the intervals say nothing. Mean score: of the surest person, where less is "
    "better.",
    cells=lambda store: (
        Cell(label={"change": name}, training={"preset": "best", "angles": MULTI} | change, timed=True)
        for name, change in CHANGES.items()
        if not (store.options.quick and name in NOT_QUICK)
    ),
    figures={"changes": Bars(y="change")},
)


# --- white box: each detector's own cloaks, at the paper's threshold and at the detector's own operating point

IMAGES_PER_VIEW = 4
"""With four unseen bodies at 21 angles: 336 images."""
WHITE_BOX_COLUMNS = ("operating_point", "success_own", "own_low", "own_high", "clothing", "clothing_own", "grey")
WHITE_BOX_COLUMNS += ("grey_own", "random", "random_own", "ap50", "clean_ap50", "false_alarms_own", "seeds")


def white_box_images(store: RunStore) -> dict:
    """Count the images of each unseen body at each azimuth."""
    return {"images_per_view": store.options.images_per_view or (2 if store.options.quick else IMAGES_PER_VIEW)}


def white_box_cells(store: RunStore) -> Cells:
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
                test={"controls": STANDARD} | white_box_images(store),
                columns=WHITE_BOX_COLUMNS,
                timed=True,
            )


WHITE_BOX = Experiment(
    title="White box on each detector, at 0.6 and at its own operating point",
    caption="Each logo is trained at five angles and judged on unseen bodies and photographs at azimuths in -10..10. "
    "Success: no person box above the threshold anywhere in the image, at the paper's 0.6 and at the confidence at "
    "which the detector is usually run. Own clothing: what the clean detector misses.",
    cells=white_box_cells,
    figures={"success": Bars(y="detector", panel="logo", own=True)},
    facts={"training_angles": MULTI},
    counts=white_box_images,
)


# --- how much a shirt must change: success against closeness to a camouflage print, white box and black box

FREE = 100.0
"""Mean CIEDE2000 that no colours have from each other: no bound."""
WITHIN = (0.0, 5.0, 10.0, 20.0, 40.0, FREE)
ALL_AROUND = "0:315:45"
"""Azimuths of training and test, degrees."""
LINE = 18
"""Pixels below a picture, for what is reported on it."""
CLOSENESS_COLUMNS = ("operating_point", "success_own", "own_low", "own_high", "clothing", "clothing_own", "seeds")


def closeness_cells(store: RunStore) -> Cells:
    judge, *others = store.specs
    people = store.split.people
    for attack, specs, preset in (("white box", [judge], "best"), ("black box", others, "transfer")):
        for within in WITHIN if specs else ():
            # The print itself is no training: its colours may not move.
            near = {"within": within} if within else {"within": 0.001, "steps": 1}
            where = {"preset": people.preset(preset)} | ({} if people else {"angles": ALL_AROUND})
            yield Cell(
                label={"attack": attack, "within": within},
                faces=shirt_trousers(store.split.bodies),
                specs=specs,
                training={"near": "camouflage"} | where | near,
                judges=[judge],
                angles=tuple(float(a) for a in range(0, 360, 45)),
                columns=CLOSENESS_COLUMNS,
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
        caption = f"person {score:.2f}" if boxes else f"no person (best {score:.2f})"
        whole = ImageOps.expand(picture, (0, 0, 0, LINE), "white")
        words = f"{cell.label['attack']}, {within}: {caption}"
        ImageDraw.Draw(whole).text((2, picture.height), words, "black", font(LINE * 2 // 3))
        rows.setdefault(cell.label["attack"], []).append(whole)
    width, height = whole.size
    strip = Image.new("RGB", (width * max(map(len, rows.values())), height * len(rows)), "white")
    for row, shown in enumerate(rows.values()):
        for column, picture in enumerate(shown):
            strip.paste(picture, (column * width, row * height))
    return {"strip": strip}


CLOSENESS = Experiment(
    title="Closeness to what people wear",
    caption="Shirt and trousers may differ from a woodland print by this mean CIEDE2000 (and by twice that at the 95th "
    "percentile); 0 is the print itself, 100 no bound. White box: trained against the first detector. Black box: "
    "trained against the others. The first detector judges: unseen bodies all around, or people in photographs.",
    cells=closeness_cells,
    figures={
        "closeness": Lines(x="within", series="attack", even=True, interval="bars"),
        "own": Lines(x="within", y="success_own", series="attack", even=True, interval=""),
    },
    pictures=pictures,
)
