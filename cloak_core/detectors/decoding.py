"""From what networks say to boxes in pixels: what heads and layouts of all families share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from cloak_core.core.detector.outcomes import best_other
from cloak_core.core.detector.protocol import Detections, at_least_float32
from cloak_core.detectors.pixels import Placement

MAX_LOG_SIZE = 20.0
"""Keeps a box finite where random weights ask for e^100."""


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


class AnchorBoxes(nn.Module):
    """Boxes that grow from anchors at every cell of a raw map [B, A * (5 + K), h, w], as in YOLOv2 to v5 and v7.

    For each of A anchors x, y, w, h, objectness and K classes. x, y and objectness are logistic. Sizes are anchor *
    exp(t) (arXiv:1804.02767, section 2.1), or with `squared` anchor * (2 s)^2 (YOLOv4-csp, v5, v7).
    """

    anchors: Tensor

    def __init__(
        self,
        anchors: Sequence[Sequence[float | int]],
        classes: int,
        *,
        in_cells: bool = False,
        softmax: bool = False,
        scale_xy: float = 1.0,
        squared: bool = False,
    ) -> None:
        """Make the head; anchors: width and height of each, in pixels of the input, or with `in_cells` in cells.

        softmax: classes exclude each other. scale_xy: how far x and y reach beyond their cell, 1 for not at all.
        squared: the map has been through the logistic function already, sizes too.
        """
        super().__init__()
        self.classes, self.in_cells, self.softmax = classes, in_cells, softmax
        self.scale_xy, self.squared = scale_xy, squared
        self.register_buffer("anchors", torch.tensor(anchors, dtype=torch.float32), persistent=False)

    @property
    def channels(self) -> int:
        """Channels of the raw map."""
        return len(self.anchors) * (5 + self.classes)

    def forward(self, raw: Float[Tensor, "B C h w"]) -> Float[Tensor, "B C h w"]:
        """Pass the raw map through, so that losses can use logits."""
        return raw

    def split(self, raw: Float[Tensor, "B C h w"]) -> Float[Tensor, "B A D h w"]:
        """Split the raw map by anchor: D = 5 + K."""
        return raw.unflatten(1, (len(self.anchors), 5 + self.classes))

    def activate(self, raw: Float[Tensor, "B A D h w"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Apply activations to a split map: x and y, w and h (still raw), objectness, classes, along D."""
        xy, classes = self.logistic(raw[:, :, :2]), raw[:, :, 5:]
        if self.scale_xy != 1.0:
            xy = xy * self.scale_xy - 0.5 * (self.scale_xy - 1)
        classes = classes.softmax(dim=2) if self.softmax else self.logistic(classes)
        return xy, raw[:, :, 2:4], self.logistic(raw[:, :, 4:5]), classes

    def logistic(self, raw: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
        """Apply the logistic function, where the network has not done so already."""
        return raw if self.squared else raw.sigmoid()

    def decode(self, raw: Float[Tensor, "B C h w"], input_size: tuple[int, int]) -> Decoded:
        """Decode the N = A * h * w boxes of a raw map of an input (height, width), as fractions of its sides."""
        raw = at_least_float32(raw)
        xy, wh, objectness, classes = self.activate(self.split(raw))
        h, w = raw.shape[-2:]
        y = (xy[:, :, 1] + torch.arange(h, device=raw.device, dtype=raw.dtype)[:, None]) / h
        x = (xy[:, :, 0] + torch.arange(w, device=raw.device, dtype=raw.dtype)) / w
        anchors = self.anchors.to(raw) / raw.new_tensor((w, h) if self.in_cells else input_size[::-1])
        sizes = 4 * wh * wh if self.squared else wh.clamp(max=MAX_LOG_SIZE).exp()
        half = sizes * anchors[None, :, :, None, None] / 2
        boxes = torch.stack([x - half[:, :, 0], y - half[:, :, 1], x + half[:, :, 0], y + half[:, :, 1]], dim=-1)
        return Decoded(boxes.flatten(1, 3), classes.movedim(2, -1).flatten(1, 3), objectness.flatten(1))


def decode_heads(
    heads: Sequence[AnchorBoxes], maps: Sequence[Float[Tensor, "B _ _ _"]], size: tuple[int, int]
) -> Decoded:
    """Decode a raw map for each head, to pixels of the network's input (height, width)."""
    parts = [head.decode(raw, size) for head, raw in zip(heads, maps, strict=True)]
    decoded = Decoded(*(torch.cat(group, dim=1) for group in zip(*parts, strict=True)))
    return decoded._replace(boxes=in_pixels(decoded.boxes, size))
