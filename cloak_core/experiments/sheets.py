"""Contact sheets: named rows of pictures, and pairs of own clothing and cloak with a detector's boxes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

import pandas as pd
import torch
from jaxtyping import Float
from PIL import Image, ImageDraw
from torch import Tensor

from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.renderer import EvaluationRenderer
from cloak_core.evaluation.report.pictures import (
    INK,
    PAPER,
    SOFT,
    describe,
    failure_trials,
    font,
    gallery_trials,
    reported,
    to_pil,
)
from cloak_core.evaluation.report.words import control_label, degrees

BOX = (224, 52, 28)
GAP, MARGIN, HEAD, FOOT = 10, 24, 34, 30
"""Of a contact sheet, pixels."""


class Cell(NamedTuple):
    """A picture of a contact sheet and the line below it."""

    image: Image.Image
    text: str
    color: tuple[int, int, int] = SOFT


def draw_sheet(heads: Sequence[str], rows: Sequence[tuple[str, Sequence[Cell]]], side: int) -> Image.Image:
    """Draw a contact sheet: named rows of pictures, `side` pixels wide and high, under column heads."""
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


@torch.no_grad()
def trial_cells(
    renderer: EvaluationRenderer,
    trial: int,
    controls: Sequence[str],
    detector: Detector,
    threshold: float,
    side: int,
) -> list[Cell]:
    """Draw one trial under these controls, a cell each, `side` pixels wide, with the boxes that a detector reports."""
    images = renderer.compose(renderer.views([trial]), [trial], controls)
    return [_cell(image, reported(image, {"": detector}, threshold), side) for image in images]


def _cell(image: Float[Tensor, "1 3 H W"], told: Mapping, side: int) -> Cell:
    """Draw an image with what `reported` told of it."""
    picture = to_pil(image[0])
    scale = side / picture.width
    picture = picture.resize((side, round(picture.height * scale)), Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(picture)
    boxes, score = told["boxes"][""], told["scores"][""]
    for x1, y1, x2, y2, _ in boxes:
        x1, y1 = max(x1 * scale, 0), max(y1 * scale, 0)
        x2, y2 = min(x2 * scale, picture.width - 1), min(y2 * scale, picture.height - 1)
        if x2 > x1 and y2 > y1:
            draw.rectangle((x1, y1, x2, y2), outline=BOX, width=max(2, side // 90))
    return Cell(picture, f"person {score:.2f}", BOX) if boxes else Cell(picture, f"no person (best {score:.2f})")


def contact_sheets(
    renderer: EvaluationRenderer, rows: pd.DataFrame, detector: Detector, threshold: float, side: int = 160
) -> dict[str, Image.Image]:
    """Draw pairs of own clothing and cloak: "gallery", chosen by rule, and "failures" where there are any.

    rows: of the detector, under the trained colours. side: of a picture, pixels.
    """
    chosen = {"gallery": gallery_trials(renderer.trials), "failures": failure_trials(rows, threshold)}
    told = {trial: describe(renderer, trial) for trials in chosen.values() for trial in trials}
    sheets = {}
    for name, trials in chosen.items():
        mixed, pairs = name == "failures", []
        bodies = [trials] if mixed else [list(own) for _, own in groupby(trials, lambda trial: told[trial]["body"])]
        for own in bodies if trials else ():
            drawn = [trial_cells(renderer, trial, (CLOTHING, LOGO), detector, threshold, side) for trial in own]
            pairs += zip(map(control_label, (CLOTHING, LOGO)), zip(*drawn, strict=True), strict=True)
        heads = [(f"{told[k]['body'][:12]}, " if mixed else "") + degrees(told[k]["angle"]) for k in bodies[0]]
        sheets |= {name: draw_sheet(heads, pairs, side)} if trials else {}
    return sheets
