"""Contact sheets: pictures side by side, with what a detector found in each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from cloak_core.scene.pictures import read_picture

BOX, INK, SOFT, PAPER = (224, 52, 28), (31, 35, 40), (89, 99, 110), (255, 255, 255)
GAP, MARGIN, HEAD, FOOT = 10, 24, 34, 30


class Cell(NamedTuple):
    """A picture and the line below it."""

    image: Image.Image
    text: str
    color: tuple[int, int, int] = SOFT


def draw_sheet(heads: Sequence[str], rows: Sequence[tuple[str, Sequence[Cell]]], side: int) -> Image.Image:
    """Named rows of pictures, `side` pixels wide and high, under column heads."""
    label = max(int(font(18, bold=True).getlength(name)) for name, _ in rows) + 2 * GAP
    width = MARGIN * 2 + label + len(heads) * (side + GAP) - GAP
    height = MARGIN + HEAD + len(rows) * (side + FOOT + GAP) + MARGIN - GAP
    sheet = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    left = MARGIN + label
    for k, head in enumerate(heads):
        draw.text((left + k * (side + GAP) + side / 2, MARGIN + HEAD / 2), head, SOFT, font(18), anchor="mm")
    for r, (name, cells) in enumerate(rows):
        top = MARGIN + HEAD + r * (side + FOOT + GAP)
        draw.text((MARGIN, top + side / 2), name, INK, font(18, bold=True), anchor="lm")
        for k, cell in enumerate(cells[: len(heads)]):
            x = left + k * (side + GAP)
            sheet.paste(cell.image, (x, top))
            draw.text((x, top + side + 4), cell.text, cell.color, font(15), anchor="la")
    return sheet


def judged(folder: Path, picture: dict, spec: str, side: int) -> Cell:
    """One of the pictures that `pictures.py` wrote into `folder`, scaled to `side`, with the detector's boxes."""
    image = Image.fromarray(read_picture(folder / Path(picture["file"]).name))
    scale = side / image.width
    image = image.resize((side, round(image.height * scale)), Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(image)
    boxes, score = picture["boxes"].get(spec, []), picture["scores"][spec]
    for x1, y1, x2, y2, _ in boxes:
        x1, y1 = max(x1 * scale, 0), max(y1 * scale, 0)
        x2, y2 = min(x2 * scale, image.width - 1), min(y2 * scale, image.height - 1)
        if x2 > x1 and y2 > y1:
            draw.rectangle((x1, y1, x2, y2), outline=BOX, width=max(2, side // 90))
    return Cell(image, f"person {score:.2f}", BOX) if boxes else Cell(image, f"no person (best {score:.2f})")


def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The figures' font, which comes with matplotlib."""
    properties = font_manager.FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")
    return ImageFont.truetype(font_manager.findfont(properties), size)
