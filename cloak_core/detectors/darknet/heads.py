"""Detection heads, [region] (YOLOv2) and [yolo] (v3, v4): from raw maps to boxes, objectness and classes."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import at_least_float32

MAX_LOG_SIZE = 20.0  # keeps a box finite where random weights ask for e^100


class HeadBoxes(NamedTuple):
    """Boxes of one head: N = anchors * h * w."""

    boxes: Float[Tensor, "B N 4"]
    """xyxy as fractions of the network's input (0..1 inside it)."""
    objectness: Float[Tensor, "B N"]
    classes: Float[Tensor, "B N K"]
    """Class probabilities, given that there is an object."""


class Head(nn.Module):
    """What both heads share. A raw map is [B, A * (5 + K), h, w]: per anchor x, y, w, h, objectness, classes."""

    anchors: Tensor

    def __init__(self, anchors: list[tuple[float, float]], classes: int) -> None:
        super().__init__()
        self.classes = classes
        self.register_buffer("anchors", torch.tensor(anchors, dtype=torch.float32), persistent=False)

    @property
    def channels(self) -> int:
        """Channels of the raw map."""
        return len(self.anchors) * (5 + self.classes)

    def forward(self, x: Tensor, earlier: dict[int, Tensor]) -> Tensor:
        """Pass the raw map through, so that losses can use logits; `activate` and `decode` interpret it."""
        return x

    def split(self, raw: Float[Tensor, "B C h w"]) -> Float[Tensor, "B A D h w"]:
        """Split the raw map by anchor: D = 5 + K."""
        b, _, h, w = raw.shape
        return raw.reshape(b, len(self.anchors), 5 + self.classes, h, w)

    def activate(self, raw: Float[Tensor, "B C h w"]) -> Float[Tensor, "B C h w"]:
        """Apply the layer's activations as Darknet does; w and h stay raw."""
        xy, wh, objectness, classes = self._parts(raw)
        return torch.cat([xy, wh, objectness, classes], dim=2).reshape(raw.shape)

    def decode(self, raw: Float[Tensor, "B C h w"], input_size: tuple[int, int]) -> HeadBoxes:
        """Decode boxes and probabilities of a raw map; `input_size` (height, width): the network input that it came
        from."""
        raw = at_least_float32(raw)
        xy, wh, objectness, classes = self._parts(raw)
        h, w = raw.shape[-2:]
        rows = torch.arange(h, device=raw.device, dtype=raw.dtype)[:, None]
        columns = torch.arange(w, device=raw.device, dtype=raw.dtype)
        x, y = (xy[:, :, 0] + columns) / w, (xy[:, :, 1] + rows) / h
        anchors = self._anchor_fractions(raw, input_size)
        half = self._sizes(wh) * anchors[None, :, :, None, None] / 2
        boxes = torch.stack([x - half[:, :, 0], y - half[:, :, 1], x + half[:, :, 0], y + half[:, :, 1]], dim=-1)
        b = len(raw)
        return HeadBoxes(
            boxes.reshape(b, -1, 4),
            objectness.reshape(b, -1),
            classes.permute(0, 1, 3, 4, 2).reshape(b, -1, self.classes),
        )

    def _parts(self, raw: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        raise NotImplementedError

    def _sizes(self, wh: Tensor) -> Tensor:
        """Compute width and height as multiples of the anchor."""
        return wh.clamp(max=MAX_LOG_SIZE).exp()

    def _anchor_fractions(self, raw: Tensor, input_size: tuple[int, int]) -> Tensor:
        """Compute anchors [A, 2] (width, height) as fractions of the network's input."""
        raise NotImplementedError


class Region(Head):
    """[region]: logistic x, y and objectness, softmax over the classes; anchors in cells."""

    def __init__(self, anchors: list[tuple[float, float]], classes: int, softmax: bool) -> None:
        super().__init__(anchors, classes)
        self.softmax = softmax

    def _parts(self, raw: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        raw = self.split(raw)
        classes = raw[:, :, 5:].softmax(dim=2) if self.softmax else raw[:, :, 5:].sigmoid()
        return raw[:, :, :2].sigmoid(), raw[:, :, 2:4], raw[:, :, 4:5].sigmoid(), classes

    def _anchor_fractions(self, raw: Tensor, input_size: tuple[int, int]) -> Tensor:
        h, w = raw.shape[-2:]
        return self.anchors.to(raw.dtype) / torch.tensor([w, h], device=raw.device, dtype=raw.dtype)


class Yolo(Head):
    """[yolo]: logistic x, y (stretched by scale_x_y), objectness and classes; anchors in input pixels.

    With new_coords (scaled YOLOv4) the convolution before it is logistic already and sizes are (2 s)² anchors.
    """

    def __init__(self, anchors: list[tuple[float, float]], classes: int, scale_xy: float, new_coords: bool) -> None:
        super().__init__(anchors, classes)
        self.scale_xy, self.new_coords = scale_xy, new_coords

    def _parts(self, raw: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        raw = self.split(raw)
        probability = raw if self.new_coords else raw.sigmoid()
        xy = probability[:, :, :2]
        if self.scale_xy != 1.0:
            xy = xy * self.scale_xy - 0.5 * (self.scale_xy - 1)
        return xy, raw[:, :, 2:4], probability[:, :, 4:5], probability[:, :, 5:]

    def _sizes(self, wh: Tensor) -> Tensor:
        return 4 * wh * wh if self.new_coords else super()._sizes(wh)

    def _anchor_fractions(self, raw: Tensor, input_size: tuple[int, int]) -> Tensor:
        height, width = input_size
        return self.anchors.to(raw.dtype) / torch.tensor([width, height], device=raw.device, dtype=raw.dtype)
