"""From images of any size to a network's input and its boxes back again, differentiably."""

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
    inner = _letterbox_size((height, width), size) if letterbox else size
    placement = Placement(scale_x=inner[1] / width, scale_y=inner[0] / height)
    if inner != (height, width):
        images = F.interpolate(images, size=inner, mode="bilinear", align_corners=True)
    if inner == size:
        return images, placement
    left, top = (size[1] - inner[1]) // 2, (size[0] - inner[0]) // 2
    right, bottom = size[1] - inner[1] - left, size[0] - inner[0] - top
    images = F.pad(images, (left, right, top, bottom), value=fill)
    return images, Placement(placement.scale_x, placement.scale_y, float(left), float(top))


def _letterbox_size(image: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    (height, width), (fit_height, fit_width) = image, size
    if fit_width * height < fit_height * width:
        return max(1, height * fit_width // width), fit_width
    return fit_height, max(1, width * fit_height // height)
