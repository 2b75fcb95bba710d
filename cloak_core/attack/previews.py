"""Preview pictures of a run: what the detector was shown last, with what it still finds."""

import math
from pathlib import Path

from jaxtyping import Float
from PIL import Image
from torch import Tensor

from cloak_core.detectors.check import draw_boxes
from cloak_core.detectors.protocol import Detections
from cloak_core.detectors.scoring import person_boxes
from cloak_core.scene.pictures import save_picture

MOST = 8
"""Images on one sheet."""


def save_preview(path: Path, images: Float[Tensor, "B 3 H W"], detections: Detections, threshold: float) -> None:
    """Save a sheet of the first images, boxes drawn around persons above `threshold`; whole or not at all."""
    count = min(len(images), MOST)
    columns = math.ceil(math.sqrt(count))
    height, width = images.shape[-2:]
    sheet = Image.new("RGB", (columns * width, math.ceil(count / columns) * height))
    boxes = person_boxes(Detections(detections.boxes[:count].detach(), detections.scores[:count].detach()), threshold)
    for i in range(count):
        sheet.paste(draw_boxes(images[i], boxes[i]), (i % columns * width, i // columns * height))
    save_picture(path, sheet)
