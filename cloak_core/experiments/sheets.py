"""Contact sheets: named rows of pictures, and pairs of own clothing and cloak with a detector's boxes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pandas as pd
from PIL import Image, ImageDraw

from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.renderer import EvaluationRenderer
from cloak_core.evaluation.report.pictures import INK, PAPER, SOFT, draw_pair, failure_trials, font, gallery_trials
from cloak_core.evaluation.report.words import control_label, degrees
from cloak_core.scene.pictures import read_picture

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


def shot_cell(folder: Path, shot: Mapping, spec: str, side: int) -> Cell:
    """Make a cell of a picture that `write_shot` wrote into `folder`, scaled to `side`, with the detector's boxes."""
    image = Image.fromarray(read_picture(folder / Path(shot["file"]).name))
    scale = side / image.width
    image = image.resize((side, round(image.height * scale)), Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(image)
    boxes, score = shot["boxes"].get(spec, []), shot["scores"][spec]
    for x1, y1, x2, y2, _ in boxes:
        x1, y1 = max(x1 * scale, 0), max(y1 * scale, 0)
        x2, y2 = min(x2 * scale, image.width - 1), min(y2 * scale, image.height - 1)
        if x2 > x1 and y2 > y1:
            draw.rectangle((x1, y1, x2, y2), outline=BOX, width=max(2, side // 90))
    return Cell(image, f"person {score:.2f}", BOX) if boxes else Cell(image, f"no person (best {score:.2f})")


def contact_sheets(
    renderer: EvaluationRenderer, rows: pd.DataFrame, spec: str, detector: Detector, threshold: float, side: int = 160
) -> dict[str, Image.Image]:
    """Draw pairs of own clothing and cloak: "gallery", chosen by rule, and "failures" where there are any.

    rows: of the detector, under the trained colours. side: of a picture, pixels.
    """
    chosen = {"gallery": gallery_trials(renderer.trials), "failures": failure_trials(rows, threshold)}
    sheets = {}
    with TemporaryDirectory() as folder:
        for name, trials in chosen.items():
            shots = [draw_pair(Path(folder), renderer, trial, {spec: detector}, threshold) for trial in trials]
            mixed = name == "failures"
            bodies = [shots] if mixed else [list(own) for _, own in groupby(shots, lambda shot: shot["body"])]
            pairs = [
                (control_label(control), [shot_cell(Path(folder), shot[control], spec, side) for shot in mine])
                for mine in bodies
                for control in (CLOTHING, LOGO)
            ]
            heads = [(f"{shot['body'][:12]}, " if mixed else "") + degrees(shot["angle"]) for shot in bodies[0]]
            sheets |= {name: draw_sheet(heads, pairs, side)} if trials else {}
    return sheets
