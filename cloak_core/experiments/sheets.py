"""Contact sheets: named rows of pictures, with the boxes that a detector reports and a line below each."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import pandas as pd
import torch
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.renderer import EvaluationRenderer
from cloak_core.evaluation.report.pictures import describe, failure_trials, gallery_trials, reported, to_pil
from cloak_core.evaluation.report.style import INK, style
from cloak_core.evaluation.report.words import control_label, degrees

BOX = "#e0341c"
INCHES, LINE = 1.6, 0.2
"""Side of a picture on a sheet, and height of the line below it."""


class Picture(NamedTuple):
    """A picture of a contact sheet, the line below it, and boxes (x1, y1, x2, y2, score)."""

    image: Image.Image
    text: str
    boxes: Sequence[Sequence[float]] = ()


def draw_sheet(rows: Mapping[str, Sequence[Picture]]) -> Image.Image:
    """Draw a contact sheet: named rows of pictures."""
    columns = max(map(len, rows.values()))
    with style(**{"axes.grid": False}):
        figure = Figure(figsize=(columns * INCHES + LINE, len(rows) * (INCHES + LINE)), layout="constrained")
        grid = figure.subplots(len(rows), columns, squeeze=False, subplot_kw={"xticks": [], "yticks": []})
        for (name, pictures), axes in zip(rows.items(), grid, strict=True):
            axes[0].set_ylabel(name, weight="bold")
            for axis in axes:
                axis.spines[:].set_visible(False)
            for axis, (image, text, boxes) in zip(axes, pictures, strict=False):
                axis.imshow(image)
                axis.set_xlabel(text, color=BOX if boxes else INK, fontsize=8)
                for x1, y1, x2, y2, _ in boxes:
                    axis.add_patch(Rectangle((x1, y1), x2 - x1, y2 - y1, fill=False, color=BOX))
        data = io.BytesIO()
        figure.savefig(data, format="png", facecolor="white")
    return Image.open(data)


@torch.no_grad()
def trial_pictures(
    renderer: EvaluationRenderer, trial: int, controls: Sequence[str], detector: Detector, threshold: float
) -> list[Picture]:
    """Show one trial under these controls, a picture each, with the boxes that a detector reports."""
    pictures = []
    for image in renderer.compose(renderer.views([trial]), [trial], controls):
        told = reported(image, {"": detector}, threshold)
        boxes, score = told["boxes"][""], told["scores"][""]
        text = f"person {score:.2f}" if boxes else f"no person (best {score:.2f})"
        pictures.append(Picture(to_pil(image[0]), text, boxes))
    return pictures


def contact_sheets(
    renderer: EvaluationRenderer, rows: pd.DataFrame, detector: Detector, threshold: float
) -> dict[str, Image.Image]:
    """Draw pairs of own clothing and cloak: "gallery", chosen by rule, and "failures" where there are any.

    rows: of the detector, under the trained colours.
    """
    chosen = {"gallery": gallery_trials(renderer.trials), "failures": failure_trials(rows, threshold)}
    sheets = {}
    for name, trials in chosen.items():
        lines: dict[str, list[Picture]] = {}
        for trial in trials:
            told, controls = describe(renderer, trial), (CLOTHING, LOGO)
            pair = trial_pictures(renderer, trial, controls, detector, threshold)
            for control, picture in zip(controls, pair, strict=True):
                body = f"{told['body']}\n" if name == "gallery" else ""
                text = f"{degrees(told['angle'])}: {picture.text}"
                lines.setdefault(body + control_label(control), []).append(picture._replace(text=text))
        sheets |= {name: draw_sheet(lines)} if lines else {}
    return sheets
