"""Detection heads, [region] (YOLOv2) and [yolo] (v3, v4): from raw maps to boxes, objectness and classes."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.detectors.decoding import Decoded

MAX_LOG_SIZE = 20.0  # keeps a box finite where random weights ask for e^100
Parts = tuple[Tensor, Tensor, Tensor, Tensor]
"""[B, A, D, h, w] of x and y (D = 2), w and h (2), objectness (1), and classes (K)."""


class Head(nn.Module):
    """What both heads share. A raw map is [B, A * (5 + K), h, w]: per anchor x, y, w, h, objectness, classes."""

    anchors: Tensor
    in_cells: bool
    """Anchors are in cells of the map, not in pixels of the input."""

    def __init__(self, anchors: list[tuple[float, float]], classes: int) -> None:
        super().__init__()
        self.classes = classes
        self.register_buffer("anchors", torch.tensor(anchors, dtype=torch.float32), persistent=False)

    @property
    def channels(self) -> int:
        """Channels of the raw map."""
        return len(self.anchors) * (5 + self.classes)

    def forward(self, x: Tensor) -> Tensor:
        """Pass the raw map through, so that losses can use logits; `activate` and `decode` interpret it."""
        return x

    def split(self, raw: Float[Tensor, "B C h w"]) -> Float[Tensor, "B A D h w"]:
        """Split the raw map by anchor: D = 5 + K."""
        return raw.unflatten(1, (len(self.anchors), 5 + self.classes))

    def activate(self, raw: Float[Tensor, "B C h w"]) -> Float[Tensor, "B C h w"]:
        """Apply the layer's activations as Darknet does; w and h stay raw."""
        return torch.cat(self._parts(self.split(raw)), dim=2).reshape(raw.shape)

    def decode(self, raw: Float[Tensor, "B C h w"], input_size: tuple[int, int]) -> Decoded:
        """Decode the N = A * h * w boxes of a raw map, as fractions of the network's input (0..1 inside it).

        input_size: (height, width) of the network input that the map came from.
        """
        raw = at_least_float32(raw)
        xy, wh, objectness, classes = self._parts(self.split(raw))
        h, w = raw.shape[-2:]
        y = (xy[:, :, 1] + torch.arange(h, device=raw.device, dtype=raw.dtype)[:, None]) / h
        x = (xy[:, :, 0] + torch.arange(w, device=raw.device, dtype=raw.dtype)) / w
        unit = (w, h) if self.in_cells else input_size[::-1]
        anchors = self.anchors.to(raw.dtype) / raw.new_tensor(unit)
        half = self._sizes(wh) * anchors[None, :, :, None, None] / 2
        boxes = torch.stack([x - half[:, :, 0], y - half[:, :, 1], x + half[:, :, 0], y + half[:, :, 1]], dim=-1)
        return Decoded(boxes.flatten(1, 3), classes.movedim(2, -1).flatten(1, 3), objectness.flatten(1))

    def _parts(self, raw: Float[Tensor, "B A D h w"]) -> Parts:
        raise NotImplementedError

    def _sizes(self, wh: Tensor) -> Tensor:
        """Compute width and height as multiples of the anchor."""
        return wh.clamp(max=MAX_LOG_SIZE).exp()


class Region(Head):
    """[region]: logistic x, y and objectness, softmax over the classes; anchors in cells."""

    in_cells = True

    def __init__(self, anchors: list[tuple[float, float]], classes: int, softmax: bool) -> None:
        super().__init__(anchors, classes)
        self.softmax = softmax

    def _parts(self, raw: Float[Tensor, "B A D h w"]) -> Parts:
        classes = raw[:, :, 5:].softmax(dim=2) if self.softmax else raw[:, :, 5:].sigmoid()
        return raw[:, :, :2].sigmoid(), raw[:, :, 2:4], raw[:, :, 4:5].sigmoid(), classes


class Yolo(Head):
    """[yolo]: logistic x, y (stretched by scale_x_y), objectness and classes; anchors in input pixels.

    With new_coords (scaled YOLOv4) the convolution before it is logistic already and sizes are (2 s)² anchors.
    """

    in_cells = False

    def __init__(self, anchors: list[tuple[float, float]], classes: int, scale_xy: float, new_coords: bool) -> None:
        super().__init__(anchors, classes)
        self.scale_xy, self.new_coords = scale_xy, new_coords

    def _parts(self, raw: Float[Tensor, "B A D h w"]) -> Parts:
        probability = raw if self.new_coords else raw.sigmoid()
        xy = probability[:, :, :2]
        if self.scale_xy != 1.0:
            xy = xy * self.scale_xy - 0.5 * (self.scale_xy - 1)
        return xy, raw[:, :, 2:4], probability[:, :, 4:5], probability[:, :, 5:]

    def _sizes(self, wh: Tensor) -> Tensor:
        return 4 * wh * wh if self.new_coords else super()._sizes(wh)
