"""Pictures of dressed people: an album with the boxes that detectors still draw, and a page of pairs for raters.

They show real people: none of them is ever published with the project.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image, ImageDraw

from cloak_core.core.evaluation.controls import CLOTHING
from cloak_core.core.evaluation.results import CORNERS
from cloak_core.core.pictures import save_picture
from cloak_core.files.writing import write_text
from cloak_core.studies.report.page import jpeg_uri, write_page
from cloak_core.studies.report.pictures import PAPER, font
from cloak_core.studies.report.style import INK
from cloak_core.studies.wearing.clothes import CONTROLS

COLORS = ((224, 52, 28), (30, 110, 220), (20, 150, 80), (190, 60, 190), (230, 150, 0), (0, 160, 170))
SHEET_PEOPLE = 12
TILE = 208
SIDE = 360
"""Width and height of a picture on the page of pairs, pixels."""


class Album:
    """Writes pictures/PERSON/before.jpg and after CLOTHES.jpg, and a contact sheet with the controls as well."""

    def __init__(self, folder: Path, people: Sequence[str], thresholds: Sequence[float]) -> None:
        """thresholds: each detector's own; boxes above it are drawn."""
        self._folder, self._people, self._thresholds = folder, people, thresholds
        step = max(1, len(people) // SHEET_PEOPLE)
        self._shown = list(range(0, len(people), step))[:SHEET_PEOPLE]
        self._tiles: dict[str, dict[int, Image.Image]] = {}

    def add(self, clothes: str, person: int, image: Image.Image, boxes: pd.DataFrame) -> None:
        """Write one image, with each detector's boxes in a colour of its own; boxes: as in `Results.boxes`."""
        picture = image.copy()
        draw = ImageDraw.Draw(picture)
        for d, threshold in enumerate(self._thresholds):
            above, color = (boxes["detector"] == d) & (boxes["score"] > threshold), COLORS[d % len(COLORS)]
            for x1, y1, x2, y2, score in boxes.loc[above, [*CORNERS, "score"]].to_numpy().tolist():
                if x2 > x1 and y2 > y1:
                    draw.rectangle((x1, y1, x2, y2), outline=color, width=2)
                    draw.text((x1 + 3, max(y1, 0) + 1), f"{score:.2f}", color, font(13, bold=True))
        if clothes not in CONTROLS:
            name = "before" if clothes == CLOTHING else f"after {file_name(clothes)}"
            place = self._folder / "pictures" / file_name(self._people[person])
            place.mkdir(parents=True, exist_ok=True)
            save_picture(place / f"{name}.jpg", picture, quality=90)
        if person in self._shown:
            self._tiles.setdefault(clothes, {})[person] = picture.resize((TILE, TILE), Image.Resampling.LANCZOS)

    def write(self) -> None:
        """Write sheet.jpg."""
        sheet = Image.new("RGB", (TILE * len(self._shown), (TILE + 20) * len(self._tiles)), PAPER)
        draw = ImageDraw.Draw(sheet)
        for row, (name, tiles) in enumerate(self._tiles.items()):
            top = row * (TILE + 20)
            draw.text((4, top + 2), name, INK, font(13, bold=True))
            for column, person in enumerate(self._shown):
                sheet.paste(tiles[person], (column * TILE, top + 20))
        save_picture(self._folder / "sheet.jpg", sheet, quality=88)


def file_name(name: str) -> str:
    """A name as a file's: letters, digits, dots, dashes."""
    return re.sub(r"[^A-Za-z0-9._=-]+", "-", name).strip("-.") or "unnamed"


class Rating:
    """Pairs for raters who do not know what is what: the same person twice, in other clothes, without boxes.

    Pairs are drawn from all people and all pairs of clothes; which picture is left is drawn as well.
    """

    def __init__(self, folder: Path, people: Sequence[str], clothes: Sequence[str], count: int) -> None:
        """clothes: two names or more. count: of the pairs, at most.

        Each two clothes are compared as often as any others, on people in an order of their own.
        """
        self._folder, self._people = folder, people
        rng, both = np.random.default_rng(0), list(combinations(clothes, 2))
        asked = [both[k % len(both)] for k in range(min(count, len(people) * len(both)))]
        turns = [rng.permutation(len(people)) for _ in both]
        self._pairs = [
            (tuple(rng.permutation(names).tolist()), int(turns[k % len(both)][k // len(both)]))
            for k, names in enumerate(asked)
        ]
        rng.shuffle(self._pairs)
        self._wanted = {(name, person) for names, person in self._pairs for name in names}
        self._pictures: dict[tuple[str, int], str] = {}

    def add(self, clothes: str, person: int, image: Image.Image, boxes: pd.DataFrame) -> None:
        """Keep an image that a pair shows."""
        if (clothes, person) in self._wanted:
            picture = image.resize((SIDE, SIDE), Image.Resampling.LANCZOS)
            self._pictures[clothes, person] = jpeg_uri(picture, quality=90)

    def write(self) -> None:
        """Write rate.html, which does not say what is what, and rate-key.csv, which does."""
        shown = [[self._pictures[name, person] for name in names] for names, person in self._pairs]
        write_page(self._folder / "rate.html", "rate.html", {"title": "Which one?", "pairs": shown})
        key = [(k, *names, self._people[person]) for k, (names, person) in enumerate(self._pairs, 1)]
        table = pd.DataFrame(key, columns=["pair", "left", "right", "person"])
        write_text(self._folder / "rate-key.csv", table.to_csv(index=False, lineterminator="\n"))
