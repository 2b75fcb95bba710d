"""Pictures with a detector's boxes drawn."""

from __future__ import annotations

import torch
from jaxtyping import Float
from PIL import Image, ImageDraw
from torch import Tensor

FRAME = (255, 60, 60)


def draw_boxes(image: Float[Tensor, "3 H W"], boxes: Float[Tensor, "n 5"]) -> Image.Image:
    """Draw each box (x1, y1, x2, y2, score) onto the image, its score beside it."""
    pixels = (image.detach().cpu().clamp(0, 1) * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()
    picture = Image.fromarray(pixels)
    draw = ImageDraw.Draw(picture)
    size = max(12, picture.height // 30)
    for x1, y1, x2, y2, score in boxes.tolist():
        x1, x2 = sorted(min(max(x, 0), picture.width - 1) for x in (x1, x2))
        y1, y2 = sorted(min(max(y, 0), picture.height - 1) for y in (y1, y2))
        draw.rectangle((x1, y1, x2, y2), outline=FRAME, width=max(2, size // 8))
        label = f"{score:.2f}"
        corner = (x1, max(0.0, y1 - size * 1.2))
        draw.rectangle(draw.textbbox(corner, label, font_size=size), fill=FRAME)
        draw.text(corner, label, fill=(255, 255, 255), font_size=size)
    return picture
