"""Preview pictures of a run: what the detector was shown last, with what it still finds."""

import math
from pathlib import Path

import torch
from jaxtyping import Float
from PIL import Image, ImageDraw
from torch import Tensor

from cloak_core.detectors.protocol import Detections
from cloak_core.detectors.scoring import person_boxes
from cloak_core.scene.pictures import save_picture

MOST = 8
"""Images on one sheet."""
FOUND = (255, 64, 64)


def save_preview(path: Path, images: Float[Tensor, "B 3 H W"], detections: Detections, threshold: float) -> None:
    """A sheet of the first images, boxes drawn around persons above `threshold`; appears whole or not at all."""
    count = min(len(images), MOST)
    columns = math.ceil(math.sqrt(count))
    height, width = images.shape[-2:]
    sheet = Image.new("RGB", (columns * width, math.ceil(count / columns) * height))
    draw = ImageDraw.Draw(sheet)
    pixels = images[:count].detach().clamp(0, 1).mul(255).round().to(torch.uint8).cpu().permute(0, 2, 3, 1).numpy()
    boxes = person_boxes(Detections(detections.boxes[:count].detach(), detections.scores[:count].detach()), threshold)
    for i in range(count):
        x, y = i % columns * width, i // columns * height
        sheet.paste(Image.fromarray(pixels[i]), (x, y))
        for x1, y1, x2, y2, score in boxes[i].tolist():
            left, top, right, bottom = max(x1, 0), max(y1, 0), min(x2, width - 1), min(y2, height - 1)
            if right > left and bottom > top:
                draw.rectangle((x + left, y + top, x + right, y + bottom), outline=FOUND, width=3)
                draw.text((x + left + 5, y + top + 4), f"{score:.2f}", fill=FOUND)
    save_picture(path, sheet)
