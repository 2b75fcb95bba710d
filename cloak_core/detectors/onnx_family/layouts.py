"""From a network's raw outputs to boxes and class probabilities, for each layout that exporters write."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.decoding import Decoded, cell_places, corners, in_pixels
from cloak_core.detectors.pixels import IMAGENET, YOLO_GREY, PixelFormat

YOLO_STRIDES = ((8, 16, 32), (8, 16, 32, 64), (16, 32), (4, 8, 16, 32))
"""Of the grids that dense heads are made of, in the order they are laid out."""
COCO_CLASSES = 80
Size = tuple[int, int]


Decode = Callable[[Sequence[Tensor], Size], Decoded]
AS_THEY_ARE = PixelFormat()
NANODET = PixelFormat(bgr=True, range=255.0, mean=(103.53, 116.28, 123.675), std=(57.375, 57.12, 58.395))


@dataclass(frozen=True)
class Layout:
    """How one kind of export is fed and read."""

    decode: Decode | None
    """None where it takes a look at real outputs to know."""
    confidence: float
    """The score above which its family usually reports a box."""
    letterbox: bool = False
    """Whether its family keeps the aspect ratio of images."""
    pixels: PixelFormat = AS_THEY_ARE
    fill: float = YOLO_GREY
    """What letterboxed images lie on."""
    told_from: Callable[[Sequence[Tensor]], Decode] | None = None

    def decoder(self, outputs: Sequence[Tensor]) -> Decode:
        """Make what decodes such outputs of real images, which settle what exports of the layout differ in."""
        return self.decode or self.told_from(outputs)


def yolov5(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode [B, N, 5 + K]: centre and size in input pixels, objectness, classes."""
    rows = outputs[0]
    return Decoded(corners(rows[..., :4]), rows[..., 5:], rows[..., 4])


def yolov8(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode [B, 4 + K, N], or transposed: centre and size in input pixels, classes; no objectness."""
    rows = outputs[0] if outputs[0].shape[1] > outputs[0].shape[2] else outputs[0].transpose(1, 2)
    return Decoded(corners(rows[..., :4]), rows[..., 4:])


def yolox(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode [B, N, 5 + K] as YOLOv5's, but offsets in cells and log sizes, strides 8, 16 and 32 in turn."""
    rows = outputs[0]
    cell, stride = _grid(size, strides_of(rows.shape[1], size) or YOLO_STRIDES[0], rows)
    boxes = torch.cat([(rows[..., :2] + cell) * stride, rows[..., 2:4].exp() * stride], dim=-1)
    return Decoded(corners(boxes), rows[..., 5:], rows[..., 4])


def detr(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode logits [B, Q, K + 1] (the last is "no object") and boxes [B, Q, 4], centre and size as fractions."""
    logits, boxes = outputs[:2] if outputs[1].shape[-1] == 4 else outputs[1::-1]
    return Decoded(corners(in_pixels(boxes, size)), logits.softmax(dim=-1)[..., :-1])


def rtdetr(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode logits [B, Q, K] of independent classes and boxes [B, Q, 4], centre and size as fractions."""
    logits, boxes = outputs[:2] if outputs[1].shape[-1] == 4 else outputs[1::-1]
    return Decoded(corners(in_pixels(boxes, size)), logits.sigmoid())


def end2end(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode [B, N, 6]: xyxy in input pixels, the best class's score and number; YOLOv10 and later.

    Of a graph cut before it chooses the best: boxes [B, N, 4] and scores [B, N, K].
    """
    if len(outputs) == 2:
        return Decoded(*outputs)
    rows = outputs[0]
    number = rows[..., 5].detach().round().long()
    count = max(COCO_CLASSES, int(number.max()) + 1) if number.numel() else COCO_CLASSES
    return Decoded(rows[..., :4], F.one_hot(number.clamp(min=0), count) * rows[..., 4:5])


@dataclass(frozen=True)
class NanoDet:
    """[B, N, K + 4 R], or class and distance outputs apart for each stride: scores, and for each side of the box a
    distribution over R distances in cells (Generalized Focal Loss, arXiv:2006.04388, equation 5)."""

    logits: bool
    """Whether scores still want a sigmoid; exports differ."""

    @classmethod
    def told_from(cls, outputs: Sequence[Tensor]) -> NanoDet:
        """Read from outputs of real images what exports differ in."""
        classes, _ = cls._split(outputs)
        return cls(logits=bool(classes.min() < 0) or bool(classes.max() > 1))

    def __call__(self, outputs: Sequence[Tensor], size: Size) -> Decoded:
        classes, sides = self._split(outputs)
        strides = strides_of(classes.shape[1], size) or YOLO_STRIDES[0]
        cell, stride = _grid(size, strides, classes)
        bins = sides.unflatten(-1, (4, -1)).softmax(dim=-1)
        distance = (bins * torch.arange(bins.shape[-1], device=bins.device, dtype=bins.dtype)).sum(-1) * stride
        # NanoDet-Plus's four strides count from the cell's corner, the older three from its middle.
        middle = (cell + (0.0 if len(strides) == 4 else 0.5)) * stride
        boxes = torch.cat([middle - distance[..., :2], middle + distance[..., 2:]], dim=-1)
        return Decoded(boxes, classes.sigmoid() if self.logits else classes)

    @staticmethod
    def _split(outputs: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        return _gathered(outputs) if len(outputs) > 1 else _parted(outputs[0])


def fastestdet(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode [B, 5 + K, h, w]: objectness, offsets, sizes, classes of one grid.

    A score is objectness^0.6 times class^0.4.
    """
    grid = outputs[0]
    height, width = grid.shape[2:]
    rows = grid.flatten(2).transpose(1, 2)
    cell = cell_places(height, width).flatten(0, 1).to(grid)
    centre = (rows[..., 1:3].tanh() + cell) / torch.tensor([width, height], device=grid.device, dtype=grid.dtype)
    boxes = in_pixels(torch.cat([centre, rows[..., 3:5].sigmoid()], dim=-1), size)
    tiny = torch.finfo(grid.dtype).tiny  # the power's slope at 0 is infinite
    score = rows[..., :1].clamp(min=tiny) ** 0.6 * rows[..., 5:].clamp(min=tiny) ** 0.4
    return Decoded(corners(boxes), score)


@dataclass(frozen=True)
class BoxesScores:
    """Boxes [B, N, 4] (or [B, N, 1, 4]) and scores [B, N, K] as two outputs, as SSD exports have them."""

    fractions: bool
    """Boxes are parts of the input's sides, not pixels."""
    corners: bool
    """Boxes are corners, not centre and size."""
    logits: bool
    exclusive: bool
    """Scores are of classes that exclude each other, the first of them "nothing"."""

    @classmethod
    def told_from(cls, outputs: Sequence[Tensor]) -> BoxesScores:
        """Read from outputs of real images what exports differ in."""
        boxes, scores = cls._split(outputs)
        logits = bool(scores.min() < 0) or bool(scores.max() > 1)
        exclusive = logits or bool(((scores.sum(-1) - 1).abs() < 1e-3).all())
        ordered = bool((boxes[..., 2:] >= boxes[..., :2]).double().mean() > 0.999)
        return cls(bool(boxes.abs().max() <= 4), ordered, logits, exclusive)

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

    anchors: tuple[tuple[tuple[int, int], ...], ...]
    """For each stride, the finest first: widths and heights, pixels of the input."""
    exponential: bool = False
    """Sizes are anchor * exp(t) (YOLOv3, arXiv:1804.02767, section 2.1), not anchor * (2 sigmoid(t))^2, and offsets
    sigmoid(t), not 2 sigmoid(t) - 0.5 (YOLOv5's and YOLOv7's own documentation)."""

    def __call__(self, outputs: Sequence[Tensor], size: Size) -> Decoded:
        heads = sorted(map(self._split, outputs), key=lambda head: -head.shape[2])
        if len(heads) != len(self.anchors):
            raise ValueError(f"{len(heads)} heads")
        found = torch.cat([self._decode(*head, size) for head in zip(heads, self.anchors, strict=True)], dim=1)
        return Decoded(corners(found[..., :4]), found[..., 5:], found[..., 4])

    def _split(self, head: Tensor) -> Float[Tensor, "B A h w C"]:
        if head.dim() == 4:
            head = head.unflatten(1, (len(self.anchors[0]), -1)).permute(0, 1, 3, 4, 2)
        if head.dim() != 5 or head.shape[1] != len(self.anchors[0]):
            raise ValueError(f"a head {list(head.shape)}")
        return head

    def _decode(self, head: Tensor, anchors: tuple, size: Size) -> Float[Tensor, "B N C"]:
        height, width = head.shape[2:4]
        cell = cell_places(height, width).to(head)
        stride = torch.tensor([size[1] / width, size[0] / height]).to(head)
        anchor = torch.tensor(anchors).to(head).view(1, -1, 1, 1, 2)
        place, rest = head[..., :2].sigmoid(), head[..., 4:].sigmoid()
        if self.exponential:
            centre, extent = place + cell, anchor * head[..., 2:4].exp()
        else:
            centre, extent = 2 * place - 0.5 + cell, anchor * (2 * head[..., 2:4].sigmoid()) ** 2
        return torch.cat([centre * stride, extent, rest], dim=-1).flatten(1, 3)


COCO_ANCHORS = (
    ((10, 13), (16, 30), (33, 23)),
    ((30, 61), (62, 45), (59, 119)),
    ((116, 90), (156, 198), (373, 326)),
)
"""Of YOLOv3 (its paper, section 2.3) and, by default, YOLOv5; at 416 and 640 pixels."""
YOLOV7_ANCHORS = (
    ((12, 16), (19, 36), (40, 28)),
    ((36, 75), (76, 55), (72, 146)),
    ((142, 110), (192, 243), (459, 401)),
)
LAYOUTS: dict[str, Layout] = {
    "yolov5": Layout(yolov5, 0.25, letterbox=True),
    "yolov8": Layout(yolov8, 0.25, letterbox=True),
    "yolox": Layout(yolox, 0.25, letterbox=True, pixels=PixelFormat(bgr=True, range=255.0)),
    "end2end": Layout(end2end, 0.25, letterbox=True),
    "detr": Layout(detr, 0.5, pixels=PixelFormat(mean=IMAGENET[0], std=IMAGENET[1])),
    "rtdetr": Layout(rtdetr, 0.5),
    "nanodet": Layout(None, 0.4, pixels=NANODET, told_from=NanoDet.told_from),
    "fastestdet": Layout(fastestdet, 0.65, pixels=PixelFormat(bgr=True)),
    "yolov3-raw": Layout(RawYolo(COCO_ANCHORS, exponential=True), 0.25, letterbox=True),
    "yolov5-raw": Layout(RawYolo(COCO_ANCHORS), 0.25, letterbox=True),
    "yolov7-raw": Layout(RawYolo(YOLOV7_ANCHORS), 0.25, letterbox=True),
    "boxes-scores": Layout(None, 0.5, told_from=BoxesScores.told_from),
}


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


def _parted(rows: Float[Tensor, "B N C"]) -> tuple[Tensor, Tensor]:
    """Split rows into classes and distances: eight distances a side, or more where COCO's classes leave more."""
    sides = 32 if rows.shape[-1] < COCO_CLASSES + 32 else rows.shape[-1] - COCO_CLASSES
    return rows[..., :-sides], rows[..., -sides:]


def _gathered(outputs: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Gather classes and distances [B, N, C] from outputs for each stride, finest grid first.

    Distances are multiples of 4 wide and the same everywhere.
    """
    flat = [output.flatten(2).transpose(1, 2) if output.dim() == 4 else output for output in outputs]
    flat.sort(key=lambda output: -output.shape[1])
    widths = [flat[0].shape[-1], flat[1].shape[-1]]
    sides = 32 if 32 in widths else min(widths)
    return tuple(torch.cat([o for o in flat if (o.shape[-1] == sides) == wanted], dim=1) for wanted in (False, True))
