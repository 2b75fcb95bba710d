"""When a person counts as detected: used by attack, evaluation and drawing alike; and the drawing of boxes."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw
from torch import Tensor

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.protocol import Detections
from cloak_core.files.errors import InputError

FRAME = (255, 60, 60)
"""Colour of the boxes that are drawn."""


def max_person_score(detections: Detections) -> Float[Tensor, " B"]:
    """Find the best person score of each image, 0 where there are no boxes; differentiable, without a threshold."""
    return row_max(detections.scores)


def max_objectness(detections: Detections) -> Float[Tensor, " B"]:
    """Find the best objectness over the boxes whose likeliest class is person (the reference's form), 0 where there is
    none.

    Where no box is a person the result is a constant 0 without gradient. InputError when the family has no objectness.
    """
    if detections.objectness is None or detections.is_person is None:
        raise InputError("the objectness loss needs a detector with objectness (darknet, builtin); use the score loss")
    return row_max(torch.where(detections.is_person, detections.objectness, 0.0))


def is_detected(detections: Detections, threshold: float = THRESHOLD) -> Bool[Tensor, " B"]:
    """Tell whether any person box in the image scores above the threshold."""
    return max_person_score(detections).detach() > threshold


def box_iou(a: Float[Tensor, "*#shape 4"], b: Float[Tensor, "*#shape 4"]) -> Float[Tensor, ...]:
    """Compute intersection over union of xyxy boxes, broadcast; 0 where both are empty."""
    sides = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0)
    intersection = sides.prod(dim=-1)
    union = _area(a) + _area(b) - intersection
    return torch.where(union > 0, intersection / union.clamp(min=torch.finfo(union.dtype).tiny), 0.0)


@torch.no_grad()
def person_boxes(detections: Detections, threshold: float = THRESHOLD, nms: float = 0.45) -> list[Float[Tensor, "n 5"]]:
    """List each image's boxes to draw or print: above the threshold, after suppression at IoU `nms`.

    Rows are x1, y1, x2, y2, score, best first.
    """
    return [suppressed(boxes, scores, threshold, nms) for boxes, scores in zip(*detections[:2], strict=True)]


def suppressed(
    boxes: Float[Tensor, "N 4"], scores: Float[Tensor, " N"], threshold: float, nms: float
) -> Float[Tensor, "n 5"]:
    """Keep one image's boxes above the threshold, after non-maximum suppression at IoU `nms`; best first."""
    from torchvision.ops import nms as kept_by_nms  # its import takes nearly two seconds

    order = scores.argsort(descending=True, stable=True)
    order = order[scores[order] > threshold]
    rows = torch.cat([boxes[order], scores[order, None]], dim=1).float().cpu()
    # A box whose corners are swapped is empty here; torchvision would count its negative sides.
    corners = torch.cat([rows[:, :2], torch.maximum(rows[:, :2], rows[:, 2:4])], dim=1)
    return rows[kept_by_nms(corners, rows[:, 4], nms)]


def row_max(values: Float[Tensor, "B N"]) -> Float[Tensor, " B"]:
    """Find the largest of each row, 0 where rows are empty."""
    # A detector may return no box at all (N = 0); the empty sum is 0 and keeps the graph.
    return values.max(dim=1).values if values.shape[1] else values.sum(dim=1)


def _area(boxes: Tensor) -> Tensor:
    return (boxes[..., 2:] - boxes[..., :2]).clamp(min=0).prod(dim=-1)


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
