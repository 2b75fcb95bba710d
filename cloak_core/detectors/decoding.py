"""From what networks say to boxes in pixels: what heads and layouts of all families share."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from cloak_core.core.detector.outcomes import best_other
from cloak_core.core.detector.protocol import Detections
from cloak_core.detectors.pixels import Placement


class Decoded(NamedTuple):
    """Of B images: N boxes and what they show; all differentiable."""

    boxes: Float[Tensor, "B N 4"]
    """xyxy, pixels of the network's input."""
    classes: Float[Tensor, "B N K"]
    """Probabilities of the classes, times objectness only where the layout has folded it in."""
    objectness: Float[Tensor, "B N"] | None = None

    @property
    def scores(self) -> Float[Tensor, "B N K"]:
        """The classes' scores, as detectors report them."""
        return self.classes if self.objectness is None else self.classes * self.objectness[..., None]

    def of_person(self, person: int, placement: Placement, first: int = 0) -> Detections:
        """Give the boxes in the images' pixels, the person's score and the best other's; see `best_other`."""
        scores, other = self.classes[..., person], best_other(self.classes, person, first)
        likeliest, best = None, other.scores
        if self.objectness is not None:
            likeliest = scores >= self.classes.amax(dim=-1)
            scores = scores * self.objectness
            best = None if best is None else best * self.objectness
        boxes = placement.restore(self.boxes)
        return Detections(boxes, scores, self.objectness, likeliest, other=best, other_class=other.number)


def queries(
    logits: Float[Tensor, "B Q K"], boxes: Float[Tensor, "B Q 4"], size: tuple[int, int], exclusive: bool
) -> Decoded:
    """Decode the answers of a transformer: boxes are centre and size, fractions of an image of (height, width).

    exclusive: classes exclude each other, and the last is "no object" (DETR); else each stands alone (RT-DETR).
    """
    classes = logits.softmax(dim=-1)[..., :-1] if exclusive else logits.sigmoid()
    return Decoded(in_pixels(corners(boxes), size), classes)


def expected_distances(sides: Float[Tensor, "*n R4"]) -> Float[Tensor, "*n 4"]:
    """Compute the mean distance to each side of a box, in cells, from a distribution over 0, 1, 2 ... for each.

    Generalized Focal Loss (arXiv:2006.04388, equation 5).
    """
    bins = sides.unflatten(-1, (4, -1))
    return bins.softmax(dim=-1) @ torch.arange(bins.shape[-1], device=bins.device, dtype=bins.dtype)


def corners(boxes: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 4"]:
    """Convert centre and size to corners."""
    half = boxes[..., 2:] / 2
    return torch.cat([boxes[..., :2] - half, boxes[..., :2] + half], dim=-1)


def in_pixels(boxes: Float[Tensor, "*n 4"], size: tuple[int, int]) -> Float[Tensor, "*n 4"]:
    """Scale boxes, fractions of the sides of an image of (height, width), to its pixels."""
    return boxes * boxes.new_tensor([size[1], size[0]] * 2)


def cell_places(height: int, width: int) -> Int[Tensor, "h w 2"]:
    """Number the columns and rows of a grid: (x, y) of every cell."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([x, y], dim=-1)
