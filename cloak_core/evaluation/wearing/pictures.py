"""Pictures of dressed people, with the boxes that detectors still draw around them; never of the project's own."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.report.pictures import font
from cloak_core.evaluation.wearing.clothes import CONTROLS
from cloak_core.evaluation.wearing.judging import Shot
from cloak_core.scene.pictures import save_picture

COLORS = ((224, 52, 28), (30, 110, 220), (20, 150, 80), (190, 60, 190), (230, 150, 0), (0, 160, 170))
SHEET_PEOPLE = 12
TILE = 208


class Album:
    """Writes pictures/PERSON/before.jpg and after CLOTHES.jpg, and a contact sheet with the controls as well."""

    def __init__(self, folder: Path, people: list[str]) -> None:
        self.folder, self.people = folder, people
        step = max(1, len(people) // SHEET_PEOPLE)
        self._shown = list(range(0, len(people), step))[:SHEET_PEOPLE]
        self._tiles: dict[str, dict[int, Image.Image]] = {}

    def add(self, shot: Shot) -> None:
        """Write one image, with each detector's boxes in a colour of its own."""
        picture = Image.fromarray((shot.image.permute(1, 2, 0).numpy() * 255).round().astype(np.uint8))
        draw = ImageDraw.Draw(picture)
        for color, (_, boxes) in zip(COLORS * len(shot.boxes), shot.boxes.items(), strict=False):
            for x1, y1, x2, y2, score in boxes.tolist():
                if x2 > x1 and y2 > y1:
                    draw.rectangle((x1, y1, x2, y2), outline=color, width=2)
                    draw.text((x1 + 3, max(y1, 0) + 1), f"{score:.2f}", color, font(13, bold=True))
        if shot.name not in CONTROLS:
            name = "before" if shot.name == CLOTHING else f"after {file_name(shot.name)}"
            place = self.folder / "pictures" / file_name(self.people[shot.person])
            place.mkdir(parents=True, exist_ok=True)
            save_picture(place / f"{name}.jpg", picture, quality=90)
        if shot.person in self._shown:
            tile = picture.resize((TILE, TILE), Image.Resampling.LANCZOS)
            self._tiles.setdefault(shot.name, {})[shot.person] = tile

    def write(self) -> None:
        """Write sheet.jpg."""
        names = list(self._tiles)
        sheet = Image.new("RGB", (TILE * len(self._shown), (TILE + 20) * len(names)), (255, 255, 255))
        draw = ImageDraw.Draw(sheet)
        for row, name in enumerate(names):
            top = row * (TILE + 20)
            draw.text((4, top + 2), name, (31, 35, 40), font(13, bold=True))
            for column, person in enumerate(self._shown):
                sheet.paste(self._tiles[name][person], (column * TILE, top + 20))
        save_picture(self.folder / "sheet.jpg", sheet, quality=88)


def file_name(name: str) -> str:
    """A name as a file's: letters, digits, dots, dashes."""
    return re.sub(r"[^A-Za-z0-9._=-]+", "-", name).strip("-.") or "unnamed"
