"""Contact sheets: named rows of pictures, with the boxes that a detector reports and a line below each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.images import ImageSet
from cloak_core.core.pattern import Pattern
from cloak_core.studies.report.pictures import reported, to_pil
from cloak_core.studies.report.style import style

BOX = "#e0341c"
INCHES, LINE, DPI = 1.6, 0.2, 150
"""Side of a picture on a sheet, and height of the line below it; pixels an inch."""


class Picture(NamedTuple):
    """A picture of a contact sheet, the line below it, and boxes (x1, y1, x2, y2, score)."""

    image: Image.Image
    text: str
    boxes: Sequence[Sequence[float]] = ()


def draw_sheet(rows: Mapping[str, Sequence[Picture]]) -> Image.Image:
    """Draw a contact sheet: named rows of pictures."""
    columns = max(map(len, rows.values()))
    with style(**{"axes.grid": False}):
        size = columns * INCHES + LINE, len(rows) * (INCHES + LINE)
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        grid = figure.subplots(len(rows), columns, squeeze=False, subplot_kw={"xticks": [], "yticks": []})
        for (name, pictures), axes in zip(rows.items(), grid, strict=True):
            axes[0].set_ylabel(name, weight="bold")
            for axis in axes:
                axis.spines[:].set_visible(False)
            for axis, (image, text, boxes) in zip(axes, pictures, strict=False):
                axis.imshow(image)
                axis.set_xlabel(text, fontsize=8)
                for x1, y1, x2, y2, _ in boxes:
                    axis.add_patch(Rectangle((x1, y1), x2 - x1, y2 - y1, fill=False, color=BOX))
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


@torch.no_grad()
def trial_picture(images: ImageSet, pattern: Pattern, trial: int, detector: Detector, threshold: float) -> Picture:
    """Show one trial in a pattern, with the boxes that a detector reports."""
    image = images.render([trial], pattern)
    report = reported(image, {"": detector}, threshold)
    boxes = report["boxes"][""]
    score = report["scores"][""]
    return Picture(to_pil(image[0]), f"person {score:.2f}" if boxes else f"no person (best {score:.2f})", boxes)
