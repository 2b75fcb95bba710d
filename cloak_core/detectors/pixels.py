"""From images of any size to a network's input (size, channels, range) and boxes back again, differentiably."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

LETTERBOX_GREY = 0.5
YOLO_GREY = 114 / 255
"""What YOLOv5 and later were trained to see around letterboxed pictures."""


@dataclass(frozen=True)
class Placement:
    """Where an image lies inside the network's input: input = image * scale + offset, per axis, in pixels."""

    scale_x: float = 1.0
    scale_y: float = 1.0
    offset_x: float = 0.0
    offset_y: float = 0.0

    def restore(self, boxes: Float[Tensor, "*shape 4"]) -> Float[Tensor, "*shape 4"]:
        """Map boxes (xyxy) from the network's input pixels to the image's pixels."""
        offset = torch.tensor([self.offset_x, self.offset_y] * 2, device=boxes.device, dtype=boxes.dtype)
        scale = torch.tensor([self.scale_x, self.scale_y] * 2, device=boxes.device, dtype=boxes.dtype)
        return (boxes - offset) / scale


def fit(
    images: Float[Tensor, "B 3 H W"], size: tuple[int, int], letterbox: bool = False, fill: float = LETTERBOX_GREY
) -> tuple[Float[Tensor, "B 3 h w"], Placement]:
    """Resize images to `size` (height, width) as Darknet does: bilinear, corner on corner pixel, no antialiasing.

    Stretches to the size; with `letterbox` keeps the aspect ratio, centred on `fill`. An image that has the size
    already passes through unchanged.
    """
    height, width = images.shape[-2:]
    inner = size
    if letterbox and size[1] * height < size[0] * width:
        inner = max(1, height * size[1] // width), size[1]
    elif letterbox:
        inner = size[0], max(1, width * size[0] // height)
    placement = Placement(scale_x=inner[1] / width, scale_y=inner[0] / height)
    if inner != (height, width):
        images = F.interpolate(images, size=inner, mode="bilinear", align_corners=True)
    if inner == size:
        return images, placement
    left, top = (size[1] - inner[1]) // 2, (size[0] - inner[0]) // 2
    right, bottom = size[1] - inner[1] - left, size[0] - inner[0] - top
    images = F.pad(images, (left, right, top, bottom), value=fill)
    return images, Placement(placement.scale_x, placement.scale_y, float(left), float(top))


IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
"""Mean and standard deviation of RGB in [0, 1]."""


@dataclass(frozen=True)
class PixelFormat:
    """input = (image * range - mean) / std, its channels in the order asked for; images are RGB in [0, 1]."""

    bgr: bool = False
    """Blue first; mean and std are then in that order, too."""
    range: float = 1.0
    """What white is: 1 or 255."""
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def apply(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        """Convert images to what the network wants, differentiably."""
        inputs = images.flip(1) if self.bgr else images
        inputs = inputs if self.range == 1 else inputs * self.range
        if any(self.mean):
            inputs = inputs - self._channels(self.mean, images)
        return inputs if set(self.std) == {1.0} else inputs / self._channels(self.std, images)

    @property
    def options(self) -> str:
        """As a spec says it."""
        listed = {"mean": "/".join(f"{v:g}" for v in self.mean), "std": "/".join(f"{v:g}" for v in self.std)}
        words = ["bgr"] * self.bgr + [f"range={self.range:g}"] * (self.range != 1)
        words += [
            f"{name}={listed[name]}"
            for name, plain in (("mean", 0.0), ("std", 1.0))
            if set(getattr(self, name)) != {plain}
        ]
        return ",".join(words) or "rgb"

    @staticmethod
    def _channels(values: tuple[float, ...], like: Tensor) -> Tensor:
        return torch.tensor(values, dtype=like.dtype, device=like.device)[:, None, None]


USUAL = (
    PixelFormat(),
    PixelFormat(range=255.0),
    PixelFormat(bgr=True),
    PixelFormat(bgr=True, range=255.0),
    PixelFormat(mean=(0.5, 0.5, 0.5), std=(0.5, 0.5, 0.5)),
    PixelFormat(mean=IMAGENET[0], std=IMAGENET[1]),
    PixelFormat(bgr=True, range=255.0, mean=(103.53, 116.28, 123.675), std=(57.375, 57.12, 58.395)),
)
"""What exporters ask for, to be tried where a file does not say."""
