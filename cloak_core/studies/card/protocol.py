"""What every card measures, in counts: cards of one version and size compare on any machine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Int64

from cloak_core.core.evaluation import CLOTHING, LOGO, NATURAL
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.trials import draw_trials
from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.logo import chest_thighs, front_faces, shirt_trousers
from cloak_core.exchange.bodies import Bodies

VERSION = "2"
"""Raise it whenever a card of the same detector would come out otherwise."""
FORMAT = f"cloak card {VERSION}"

AREAS = (0.05, 0.20, 0.40, 0.76)
"""Shares of the body's area that the white-box cloaks cover."""
FRONT = "-10:10:5"
"""Training azimuths of the white-box cloaks; distance and elevation are the paper's (2.2 m, 6 degrees)."""
CIRCLE = "0:330:30"
"""Training azimuths of the cloak for the full circle."""
AGAINST = "made against it"
"""What the largest cloak for the front is called on people in photographs."""
UNTRAINED = (CLOTHING, "grey", "random", "resampled")
"""What people in photographs wear as controls."""
HEAD_CLOTH = "zoo:transfer-people"
HEADS = {
    "transfer-people and hood, face free": "shirt+trousers+hood",
    "transfer-people and whole head": "shirt+trousers+head",
}
"""Rows of people in `HEAD_CLOTH`, which covers their heads, too: name -> regions. No headline counts them."""
GREY_HEAD = "own clothing, head in grey"
"""The control of these rows: own clothing, and the head in grey, which alone may hide somebody."""
MEASURED, AT_LEAST = "measured", "at least"
"""How sure a figure is."""
BESIDE = (CLOTHING, "random")
"""Controls beside every cloak."""
ROWS = "rows"
"""Folder beside card.json."""
CLEAN_ANGLES = tuple(float(a) for a in range(0, 360, 45))
CLEAN_ELEVATIONS = (0.0, 6.0, 15.0, 30.0)
CLEAN_DISTANCES = (1.4, 2.2, 3.2, 4.5, 6.0)

ENOUGH_LARGEST = 150
"""Updates after which the largest cloak is near its end. In our records (success at the detector's own threshold on
76 % of the body) 150 updates reached at least 0.94 of what 300 or 1,500 did: docs/card.md has the table."""
ENOUGH = 600
"""Updates after which any other cloak is. On 20 % of the body 150 updates reached 0.40 to 0.76 of the end, and 300
reached 0.89 of 1,500 for the slowest detector."""


@dataclass(frozen=True)
class Size:
    """How much a card measures; everything is a count."""

    name: str
    steps: int
    """Updates of each white-box cloak; the one for the full circle takes twice as many."""
    seeds: int
    """Repetitions of every training."""
    front_step: int
    """Degrees between the test azimuths in -10 .. 10."""
    circle_step: int
    """Degrees between the test azimuths all around."""
    images_per_view: int
    """Test images of every unseen body at each of those azimuths."""
    clean_images: int
    """Images in own clothing from everywhere: near and far, around, from eye level and above."""
    bare: int
    """Scenes without anybody, for false alarms."""
    people: int
    """People in photographs, the first ones of the file."""
    patterns: int
    """Published patterns, the first ones given."""
    areas: tuple[float, ...] = AREAS
    circle: bool = True
    """Whether a cloak for the full circle is made."""
    pixels: int = 416
    """Width and height of the images."""


# quick has fewer attacks than the others, none that its updates would leave short (`ENOUGH`).
QUICK = Size("quick", 300, 1, 5, 30, 3, 240, 128, 40, 3, areas=AREAS[-1:], circle=False)
STANDARD = Size("standard", 600, 1, 2, 20, 3, 720, 256, 120, 12)
FULL = Size("full", 1500, 3, 1, 15, 4, 1920, 256, 400, 48)
SIZES = {size.name: size for size in (QUICK, STANDARD, FULL)}


@dataclass(frozen=True)
class Part:
    """One measurement of a card; its rows are a table for each repetition (`Results`), in the folder rows/."""

    name: str
    """"clean", "area 76%", "circle", "zoo NAME", "pattern NAME", "people"."""
    angles: tuple[float, ...] = ()
    """Test azimuths, degrees."""
    settings: Mapping[str, object] = field(default_factory=dict)
    """Evaluation settings by name; none for people in photographs."""
    steps: int = 0
    """Updates of the cloak's training; 0 where nothing is trained."""
    area: float | None = None
    """Share of the body that a cloak for the front is to cover."""
    repetitions: int = 1
    """How often the cloak is trained."""

    @property
    def files(self) -> list[str]:
        """Names of the files of rows, one for each repetition."""
        stem = "".join(letter if letter.isalnum() or letter in "-_=" else "-" for letter in self.name)
        return [f"{stem}.{k}.npz" for k in range(self.repetitions)]

    def drawn(self, unseen: Mapping, backgrounds: int) -> tuple[tuple[str, ...], pd.DataFrame]:
        """List what rendered bodies wear, and draw their trials. unseen: bodies, as `materials` tell of them."""
        settings = EvaluateSettings(**self.settings)
        trials = draw_trials(len(unseen["poses"]), self.angles, backgrounds, unseen["outfits"], settings)
        return (LOGO, *dict.fromkeys((CLOTHING, *settings.controls))), trials

    def state(self, partial_gradient: str) -> str:
        """Tell how sure its attack is: at least, where it was short or followed a part of the gradient alone.

        One that was not trained against the detector itself is measured.
        """
        enough = ENOUGH_LARGEST if self.area == AREAS[-1] else ENOUGH
        return AT_LEAST if self.steps and (self.steps < enough or partial_gradient) else MEASURED


def part_of_area(area: float) -> str:
    """Name the part of an area's cloak."""
    return f"area {area:.0%}"


def parts_of(stated: Mapping, size: Size) -> list[Part]:
    """List the parts of a card in the order of measuring. stated: what a card says itself (`entry.CARD`)."""
    base = {"size": size.pixels, "shift": min(50, size.pixels // 8), "seed": stated["made"]["seed"]}
    # Own clothing and untrained patterns from everywhere, and bare scenes.
    places = (
        len(CLEAN_ANGLES) * len(CLEAN_ELEVATIONS) * len(CLEAN_DISTANCES) * len(stated["materials"]["unseen"]["poses"])
    )
    clean = base | {
        "elevations": CLEAN_ELEVATIONS,
        "distances": CLEAN_DISTANCES,
        "images_per_view": math.ceil(size.clean_images / places),
        "most_images": size.clean_images,
        "bare": size.bare,
        "controls": (CLOTHING, "grey", "random", *NATURAL),
    }
    worn = base | {"images_per_view": size.images_per_view, "controls": BESIDE, "bare": 1}
    front_angles = tuple(map(float, range(-10, 11, size.front_step)))
    parts = [Part("clean", CLEAN_ANGLES, clean)]
    if stated["differentiable"]:
        front = partial(Part, angles=front_angles, settings=worn, steps=size.steps, repetitions=size.seeds)
        parts += [front(part_of_area(area), area=area) for area in size.areas]
        circle_angles = tuple(map(float, range(0, 360, size.circle_step)))
        around = Part("circle", circle_angles, worn, 2 * size.steps, repetitions=size.seeds)
        parts += [around] * size.circle
    shown = [f"zoo {row['name']}" for row in stated["black_box"]["zoo"]]
    shown += [f"pattern {row['name']}" for row in stated["patterns"]]
    parts += [Part(name, front_angles, worn) for name in shown]
    return parts + [Part("people")] * (stated.get("photographs") is not None)


def keep_rows(folder: Path, part: Part, repetitions: Sequence[Results]) -> None:
    """Write a part's rows beside the card."""
    (folder / ROWS).mkdir(exist_ok=True)
    for name, results in zip(part.files, repetitions, strict=True):
        results.save(folder / ROWS / name)


def nested_areas(bodies: Bodies, shares: tuple[float, ...]) -> list[Int64[np.ndarray, " L"]]:
    """Choose faces of shirt and trousers for each share of the body's area (0 to 1): sorted face ids.

    The front comes before the back, each from the middle of the chest outwards, so every larger logo holds the smaller
    ones; none is more than the garments.
    """
    garments = shirt_trousers(bodies)
    areas = face_areas(bodies)
    centres = face_centres(bodies)
    front = front_faces(bodies)
    if "chest" in bodies.regions:
        chest = np.flatnonzero(bodies.regions["chest"] & front)
    else:
        # The upper half of what such a scene has for chest and thighs.
        chest = chest_thighs(bodies)
        height = centres[chest, 1]
        chest = chest[height > (height.min() + height.max()) / 2]
    middle = np.average(centres[chest], axis=0, weights=areas[chest])
    away = np.linalg.norm(centres[garments] - middle, axis=1)
    order = garments[np.lexsort((garments, away, ~front[garments]))]
    covered = np.cumsum(areas[order]) / areas.sum()
    counts = (max(1, int(np.searchsorted(covered, share, side="right"))) for share in shares)
    return [np.sort(order[:count]) for count in counts]
