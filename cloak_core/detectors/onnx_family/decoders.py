"""From a network's raw outputs to boxes and class probabilities, for each layout that exporters write."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.classes import COCO
from cloak_core.detectors.decoding import (
    AnchorBoxes,
    Decoded,
    cell_places,
    corners,
    decode_heads,
    expected_distances,
    in_pixels,
    queries,
)

Size = tuple[int, int]
Decode = Callable[[Sequence[Tensor], Size], Decoded]
"""From a network's outputs and the (height, width) of its input to boxes in pixels of that input. Some have `settled`,
which settles from the outputs of a real image what exports differ in."""
YOLO_STRIDES = ((8, 16, 32), (8, 16, 32, 64), (16, 32), (4, 8, 16, 32))
"""Of the grids that dense heads are made of, in the order they are laid out."""


@dataclass(frozen=True)
class YoloRows:
    """[B, N, 4 + K], or transposed; with objectness [B, N, 5 + K]: centre and size, classes."""

    objectness: bool
    fractions: bool = False
    """Boxes are parts of the input's sides, not pixels."""

    def settled(self, outputs: Sequence[Tensor]) -> YoloRows:
        return replace(self, fractions=bool(self(outputs, (1, 1)).boxes.abs().max() < 2))

    def __call__(self, outputs: Sequence[Tensor], size: Size) -> Decoded:
        rows = outputs[0]
        if not self.objectness and rows.shape[1] <= rows.shape[2]:
            rows = rows.transpose(1, 2)
        boxes = corners(in_pixels(rows[..., :4], size) if self.fractions else rows[..., :4])
        return Decoded(boxes, rows[..., 5:], rows[..., 4]) if self.objectness else Decoded(boxes, rows[..., 4:])


def yolox(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode [B, N, 5 + K] as YOLOv5's, but offsets in cells and log sizes, strides 8, 16 and 32 in turn."""
    rows = outputs[0]
    cell, stride = _grid(size, strides_of(rows.shape[1], size) or YOLO_STRIDES[0], rows)
    boxes = torch.cat([(rows[..., :2] + cell) * stride, rows[..., 2:4].exp() * stride], dim=-1)
    return Decoded(corners(boxes), rows[..., 5:], rows[..., 4])


@dataclass(frozen=True)
class Queries:
    """Logits [B, Q, K] and boxes [B, Q, 4] of a transformer, in either order (`decoding.queries`)."""

    exclusive: bool

    def __call__(self, outputs: Sequence[Tensor], size: Size) -> Decoded:
        logits, boxes = outputs[:2] if outputs[1].shape[-1] == 4 else outputs[1::-1]
        return queries(logits, boxes, size, self.exclusive)


def end2end(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode [B, N, 6]: xyxy in input pixels, the best class's score and number; YOLOv10 and later."""
    rows = outputs[0]
    return Decoded(rows[..., :4], _one_hot(rows[..., 5].detach(), rows[..., 4], len(COCO)))


def every_box(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode xyxy in input pixels and all classes' scores, before a graph chooses among them: apart, or in one row."""
    rows = outputs[0]
    return Decoded(*outputs) if len(outputs) == 2 else Decoded(rows[..., :4], rows[..., 4:])


@dataclass(frozen=True)
class NanoDet:
    """[B, N, K + 4 R], or class and distance outputs apart for each stride: scores, and for each side of the box a
    distribution over R distances in cells (`expected_distances`)."""

    logits: bool = False
    """Whether scores still want a sigmoid; exports differ."""

    def settled(self, outputs: Sequence[Tensor]) -> NanoDet:
        return NanoDet(are_logits(self._split(outputs)[0]))

    def __call__(self, outputs: Sequence[Tensor], size: Size) -> Decoded:
        classes, sides = self._split(outputs)
        strides = strides_of(classes.shape[1], size) or YOLO_STRIDES[0]
        cell, stride = _grid(size, strides, classes)
        distance = expected_distances(sides) * stride
        # NanoDet-Plus's four strides count from the cell's corner, the older three from its middle.
        middle = (cell + (0.0 if len(strides) == 4 else 0.5)) * stride
        boxes = torch.cat([middle - distance[..., :2], middle + distance[..., 2:]], dim=-1)
        return Decoded(boxes, classes.sigmoid() if self.logits else classes)

    @staticmethod
    def _split(outputs: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """Part classes [B, N, K] and distances [B, N, 4 R], finest grid first."""
        if len(outputs) == 1:  # eight distances a side, or more where COCO's classes leave more
            width = outputs[0].shape[-1]
            sides = 32 if width < len(COCO) + 32 else width - len(COCO)
            return outputs[0][..., :-sides], outputs[0][..., -sides:]
        flat = [output.flatten(2).transpose(1, 2) if output.dim() == 4 else output for output in outputs]
        flat.sort(key=lambda output: -output.shape[1])
        widths = [flat[0].shape[-1], flat[1].shape[-1]]
        sides = 32 if 32 in widths else min(widths)
        return tuple(torch.cat([o for o in flat if (o.shape[-1] == sides) == wanted], 1) for wanted in (False, True))


def fastestdet(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode [B, 5 + K, h, w]: objectness, offsets, sizes, classes of one grid.

    A score is objectness^0.6 times class^0.4.
    """
    grid = outputs[0]
    height, width = grid.shape[2:]
    rows = grid.flatten(2).transpose(1, 2)
    cell = cell_places(height, width).flatten(0, 1).to(grid)
    centre = (rows[..., 1:3].tanh() + cell) / grid.new_tensor([width, height])
    boxes = in_pixels(torch.cat([centre, rows[..., 3:5].sigmoid()], dim=-1), size)
    tiny = torch.finfo(grid.dtype).tiny  # the power's slope at 0 is infinite
    score = rows[..., :1].clamp(min=tiny) ** 0.6 * rows[..., 5:].clamp(min=tiny) ** 0.4
    return Decoded(corners(boxes), score)


@dataclass(frozen=True)
class BoxesScores:
    """Boxes [B, N, 4] (or [B, N, 1, 4]) and scores [B, N, K] as two outputs, as SSD exports have them."""

    fractions: bool = False
    """Boxes are parts of the input's sides, not pixels."""
    corners: bool = True
    """Boxes are corners, not centre and size."""
    logits: bool = False
    exclusive: bool = False
    """Scores are of classes that exclude each other, the first of them "nothing"."""

    def settled(self, outputs: Sequence[Tensor]) -> BoxesScores:
        boxes, scores = self._split(outputs)
        logits = are_logits(scores)
        exclusive = logits or bool(((scores.sum(-1) - 1).abs() < 1e-3).all())
        ordered = bool((boxes[..., 2:] >= boxes[..., :2]).double().mean() > 0.999)
        return BoxesScores(bool(boxes.abs().max() <= 4), ordered, logits, exclusive)

    def __call__(self, outputs: Sequence[Tensor], size: Size) -> Decoded:
        boxes, scores = self._split(outputs)
        boxes = in_pixels(boxes, size) if self.fractions else boxes
        scores = scores.softmax(dim=-1) if self.logits else scores
        return Decoded(boxes if self.corners else corners(boxes), scores[..., 1:] if self.exclusive else scores)

    @staticmethod
    def _split(outputs: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        boxes, scores = outputs[:2] if outputs[0].shape[-1] == 4 else outputs[1::-1]
        return boxes.reshape(len(boxes), -1, 4), scores


@dataclass(frozen=True)
class RawYolo:
    """One output for each stride, [B, A (5 + K), h, w] or [B, A, h, w, 5 + K], as anchor-based YOLOs have them before
    anything is decoded: offsets, sizes, objectness and classes, all as logits."""

    anchors: tuple[tuple[tuple[float | int, float | int], ...], ...]
    """For each stride, the finest first: widths and heights, pixels of the input."""
    exponential: bool = False
    """Sizes are anchor * exp(t) (YOLOv3, arXiv:1804.02767, section 2.1), not anchor * (2 sigmoid(t))^2, and offsets
    sigmoid(t), not 2 sigmoid(t) - 0.5 (YOLOv5's and YOLOv7's own documentation)."""

    def __call__(self, outputs: Sequence[Tensor], size: Size) -> Decoded:
        count, maps = (
            len(self.anchors[0]),
            [o.permute(0, 1, 4, 2, 3).flatten(1, 2) if o.dim() == 5 else o for o in outputs],
        )
        if any(raw.dim() != 4 or raw.shape[1] % count for raw in maps):
            raise ValueError(f"heads {[list(raw.shape) for raw in outputs]}")
        maps.sort(key=lambda raw: -raw.shape[2])
        classes, scale = maps[0].shape[1] // count - 5, 1.0 if self.exponential else 2.0
        heads = [
            AnchorBoxes(anchors, classes, scale_xy=scale, squared=not self.exponential) for anchors in self.anchors
        ]
        return decode_heads(heads, maps if self.exponential else [raw.sigmoid() for raw in maps], size)


@dataclass(frozen=True)
class SsdHead:
    """The inputs of OpenVINO's DetectionOutput: offsets [1, 4 N], class scores [1, N K], priors [1, 2, 4 N].

    Decoding as in SSD (Liu et al., arXiv:1512.02325, section 2.2): every box, before threshold and suppression.
    """

    classes: int
    """With the background."""
    background: int
    """Its index; -1: none."""
    center_size: bool
    """Offsets are of centre and log size, not of corners."""
    scaled: bool
    """Offsets are multiplied by the priors' variances."""

    def __call__(self, outputs: Sequence[Tensor], size: Size) -> Decoded:
        offsets, scores = outputs[0].view(len(outputs[0]), -1, 4), outputs[1].view(len(outputs[1]), -1, self.classes)
        priors, variances = outputs[2].view(len(outputs[2]), 2, -1, 4).unbind(1)
        offsets = offsets * variances if self.scaled else offsets
        if self.center_size:
            extent = priors[..., 2:] - priors[..., :2]
            centre = (priors[..., :2] + priors[..., 2:]) / 2 + offsets[..., :2] * extent
            boxes = corners(torch.cat([centre, offsets[..., 2:].exp() * extent], dim=-1))
        else:
            boxes = priors + offsets
        kept = [number for number in range(self.classes) if number != self.background]
        return Decoded(in_pixels(boxes, size), scores[..., kept])


def detection_rows(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode rows [1, 1, N, 7] after suppression: image (-1 ends them), class (from 1), score, corners as fractions."""
    rows = outputs[0].flatten(1, 2) if outputs[0].dim() == 4 else outputs[0]
    # Whatever stands behind the end is left over from another image.
    there = (rows[..., 0] >= 0).cummin(dim=1).values
    return Decoded(in_pixels(rows[..., 3:7], size), _one_hot(rows[..., 1] - 1, rows[..., 2] * there))


def boxes_labels(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode boxes [N, 5] after suppression (corners in pixels of the input, score) and their classes [N]."""
    boxes, labels = sorted((output.reshape(-1, output.shape[-1]) for output in outputs[:2]), key=lambda o: -o.shape[1])
    boxes = boxes.view(1, -1, 5)
    return Decoded(boxes[..., :4], _one_hot(labels.reshape(1, -1), boxes[..., 4]))


def tflite_ssd(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode TFLite_Detection_PostProcess: boxes [1, N, 4], classes, scores, count.

    Boxes are top, left, bottom, right, as fractions.
    """
    boxes, classes, scores, count = outputs[:4]
    there = torch.arange(scores.shape[1]) < count.reshape(-1, 1)
    return Decoded(in_pixels(boxes[..., [1, 0, 3, 2]], size), _one_hot(classes, scores * there))


POSE_ANCHORS = {8: 2, 16: 2, 32: 6}
"""Of MediaPipe's pose detector, by stride: anchors in each cell (two for each layer, its pose_detection_cpu.pbtxt)."""
POSE_WIDTH = 0.4
"""Of a person's width to her length: the network tells no width."""
LOGIT_LIMIT = 100.0
"""MediaPipe clips logits to this."""


def mediapipe_pose(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode MediaPipe's pose detector: regressors [1, N, 12] and logits [1, N, 1]; only persons.

    Its own box is a square on the face, so the person's is made of two key points: the middle of the hips, and the end
    of a radius around the whole body; the box around a rectangle of that axis.
    """
    raw, logits = sorted(outputs[:2], key=lambda output: -output.shape[-1])
    anchors = []
    for stride, count in POSE_ANCHORS.items():
        middles = (cell_places(size[0] // stride, size[1] // stride).view(-1, 2) + 0.5) * stride
        anchors.append(middles.repeat_interleave(count, dim=0))
    hips, end = (raw[..., k : k + 2] + torch.cat(anchors).to(raw) for k in (4, 6))
    half = (end - hips).abs()
    half = half + POSE_WIDTH * half.flip(-1)
    boxes = torch.cat([hips - half, hips + half], dim=-1)
    return Decoded(boxes, logits.clamp(-LOGIT_LIMIT, LOGIT_LIMIT).sigmoid())


def cells(size: Size, strides: Sequence[int]) -> int:
    """Count the cells of the grids of these strides together on an input (height, width)."""
    return sum(math.ceil(size[0] / s) * math.ceil(size[1] / s) for s in strides)


def strides_of(count: int, size: Size) -> tuple[int, ...] | None:
    """Find the usual strides whose grids have `count` cells together; None where no such do."""
    return next((strides for strides in YOLO_STRIDES if cells(size, strides) == count), None)


def _grid(size: Size, strides: Sequence[int], like: Tensor) -> tuple[Float[Tensor, "N 2"], Float[Tensor, "N 1"]]:
    """Compute the column and row of every cell, and its stride in pixels."""
    places, steps = [], []
    for stride in strides:
        height, width = math.ceil(size[0] / stride), math.ceil(size[1] / stride)
        places.append(cell_places(height, width).flatten(0, 1))
        steps.append(torch.full((height * width, 1), stride))
    return torch.cat(places).to(like), torch.cat(steps).to(like)


def are_logits(scores: Tensor) -> bool:
    """Tell whether scores are no probabilities yet."""
    return bool(scores.min() < 0) or bool(scores.max() > 1)


def _one_hot(numbers: Float[Tensor, "B N"], scores: Float[Tensor, "B N"], least: int = 91) -> Float[Tensor, "B N K"]:
    """Put each row's score in the place of its class; `least` places, so that images agree on their number."""
    index = numbers.round().long().clamp(min=0)
    count = max(least, int(index.max()) + 1 if index.numel() else 0)
    return F.one_hot(index, count) * scores[..., None]
