"""From a network's feature maps to boxes and probabilities, all of them, before any choice of the best.

Written from the published descriptions: the anchor-free head of YOLOv8 and later (task-aligned, Generalized Focal
Loss, arXiv:2006.04388; both assignments of YOLOv10, arXiv:2405.14458) and the anchors of YOLOv5
(https://docs.ultralytics.com/yolov5/tutorials/architecture_description, "Eliminate Grid Sensitivity").
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.detectors.decoding import Decoded, cell_places, expected_distances
from cloak_core.detectors.onnx_family.decoders import RawYolo

Maps = list[tuple[Tensor, Tensor]]
"""For each branch and stride, what the network says before any activation: of boxes [B, 4 * bins, h, w], and of classes
[B, K, h, w]."""
BRANCHES = (("cv2", "cv3"), ("one2one_cv2", "one2one_cv3"))
"""Of ultralytics' heads: the convolutions for boxes and for classes, one-to-many and one-to-one."""


class DenseHead(nn.Module):
    """The detecting part of an ultralytics head: a box at every cell of every feature map, for each of its branches.

    Where a network has both, the boxes of the one-to-many branch (which people use with suppression) come first, then
    those of the one-to-one branch (which needs none): a cloak has to hide from both.
    """

    def __init__(self, head: nn.Module) -> None:
        super().__init__()
        self.f, self.i, self.type = head.f, head.i, "DenseHead"
        there = [[getattr(head, name, None) for name in names] for names in BRANCHES]
        self.branches = nn.ModuleList(nn.ModuleList(pair) for pair in there if None not in pair)
        self.strides = [float(stride) for stride in head.stride]
        self.replaced = (head,)
        """The package's own, which has the same weights; in a tuple, so that it is no part of this one."""

    def forward(self, features: list[Tensor]) -> Maps:
        """Run every branch on feature maps [B, C, h, w], one a stride: boxes, classes."""
        return [
            (box(x), kind(x))
            for boxes, classes in self.branches
            for x, box, kind in zip(features, boxes, classes, strict=True)
        ]

    def decode(self, maps: Maps) -> Decoded:
        """Decode boxes in pixels of the network's input, and classes [B, N, K]."""
        corner = []
        for (box, _), stride in zip(maps, self.strides * len(self.branches), strict=True):
            sides = distances(box)
            middle = cell_places(*box.shape[-2:]).flatten(0, 1).to(sides) + 0.5
            corner.append(torch.cat([middle - sides[..., :2], middle + sides[..., 2:]], dim=-1) * stride)
        return Decoded(torch.cat(corner, dim=1), torch.cat([rows(kind).sigmoid() for _, kind in maps], dim=1))


class AnchorHead(nn.Module):
    """YOLOv5's own head: at every cell a box for each anchor, with objectness (`RawYolo`)."""

    def __init__(
        self,
        anchors: Float[Tensor, "levels A 2"],
        strides: Sequence[float],
        channels: Sequence[int],
        classes: int,
        place: tuple[list[int], int],
    ) -> None:
        """Make the head; anchors: width and height in pixels; channels: of each feature map.

        place: which layers feed it, and which it is.
        """
        super().__init__()
        (self.f, self.i), self.type = place, "AnchorHead"
        self.strides = [float(stride) for stride in strides]
        self.m = nn.ModuleList(nn.Conv2d(c, anchors.shape[1] * (5 + classes), 1) for c in channels)
        self.register_buffer("anchors", anchors)
        self.raw = RawYolo(tuple(tuple(map(tuple, level)) for level in anchors.tolist()))

    def forward(self, features: list[Tensor]) -> list[Float[Tensor, "B _ _ _"]]:
        """Run on feature maps [B, C, h, w], one a stride: [B, A * (4 + 1 + classes), h, w]."""
        return [conv(x) for x, conv in zip(features, self.m, strict=True)]

    def decode(self, maps: list[Float[Tensor, "B _ _ _"]]) -> Decoded:
        """Decode boxes in pixels of the network's input, classes and objectness."""
        size = tuple(round(side * self.strides[0]) for side in maps[0].shape[2:])
        return self.raw([at_least_float32(x) for x in maps], size)


def rows(x: Float[Tensor, "B C h w"]) -> Float[Tensor, "B n C"]:
    """Flatten a map to one row for each of its cells, at least float32."""
    return at_least_float32(x).flatten(2).transpose(1, 2)


def distances(box: Float[Tensor, "B C h w"]) -> Float[Tensor, "B n 4"]:
    """Compute distances from every cell to the four sides of its box, in cells: four numbers, or distributions."""
    sides = rows(box)
    return sides if sides.shape[-1] == 4 else expected_distances(sides)
