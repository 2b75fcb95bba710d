"""What cameras and files do to images, differentiably: zoom, crop, margin, tint, blur, JPEG's loss; and things that
stand in the way."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from torch import Tensor

from cloak_core.core.filters import TO_YCC, blurred, through_jpeg, windowed
from cloak_core.core.paint import Canvas, pixels_of

OCCLUDER_SIDES = (0.15, 0.45)
"""Sides of an occluder as shares of the body's box."""


@dataclass(frozen=True)
class Distortion:
    """What happens to B images after they were composed; None: nothing of that kind."""

    zoom: Float[Tensor, "B"] | None = None
    """Factors about the centre; what comes in at the edge is mirrored."""
    window: Float[Tensor, "B 3"] | None = None
    """Side and centre (x, y) of what is shown, in units in which the image's edges are at -1 and 1."""
    tint: Float[Tensor, "B 4"] | None = None
    """Factors of red, green, blue and of the saturation."""
    blur: Float[Tensor, "B"] | None = None
    """Standard deviations of a Gaussian, pixels."""
    quality: Float[Tensor, "B"] | None = None
    """Of JPEG, 1..100."""

    def __call__(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        if self.zoom is not None:
            images = zoomed(images, self.zoom)
        if self.window is not None:
            images = windowed(images, self.window)
        if self.tint is not None:
            images = tinted(images, self.tint)
        if self.blur is not None:
            images = blurred(images, self.blur)
        if self.quality is not None:
            images = through_jpeg(images, self.quality)
        return images

    def boxes(self, boxes: Float[Tensor, "B 4"], height: int, width: int) -> Float[Tensor, "B 4"]:
        """Move boxes (xyxy, pixels) with the images of this size, and clip them to what is still shown."""
        size = boxes.new_tensor([width, height] * 2)
        at = 2 * boxes / size - 1
        if self.zoom is not None:
            at = at * self.zoom[:, None]
        if self.window is not None:
            at = (at - self.window[:, [1, 2, 1, 2]]) / self.window[:, :1]
        return torch.minimum(((at + 1) * size / 2).clamp(min=0), size)


def zoomed(images: Float[Tensor, "B 3 H W"], factor: Float[Tensor, "B"]) -> Float[Tensor, "B 3 H W"]:
    """Enlarge each image about its centre by its factor, bilinearly, at the same size."""
    scale = torch.zeros(len(images), 2, 3, dtype=images.dtype, device=images.device)
    scale[:, 0, 0] = scale[:, 1, 1] = 1 / factor
    grid = F.affine_grid(scale, list(images.shape), align_corners=False)
    return F.grid_sample(images, grid, padding_mode="reflection", align_corners=False)


def tinted(images: Float[Tensor, "B 3 H W"], factors: Float[Tensor, "B 4"]) -> Float[Tensor, "B 3 H W"]:
    """Multiply channels by the first three factors, then each pixel's distance from grey by the last; clamp.

    The gradient passes the clamp within [0, 1].
    """
    images = images * factors[:, :3, None, None]
    luma = torch.tensor(TO_YCC[0], dtype=images.dtype, device=images.device).view(1, 3, 1, 1)
    grey = (images * luma).sum(1, keepdim=True)
    return torch.lerp(grey.expand_as(images), images, factors[:, 3].view(-1, 1, 1, 1)).clamp(0, 1)


def occluded(
    canvas: Canvas, boxes: Sequence[tuple[int, int, int, int, int]], pictures: Sequence[UInt8[Tensor, "3 H W"]]
) -> Canvas:
    """Put rectangles before the canvas's bodies, each cut from its picture at the same place.

    boxes: image, x0, y0, x1, y1, pixels, within the images. What lies behind gets no gradient.
    """
    images = pixels_of(canvas.rows, canvas.shape)
    batch, _, height, width = canvas.shape
    hidden = torch.zeros(len(canvas.rows), dtype=torch.bool, device=canvas.rows.device)
    areas = hidden[:-1].view(batch, height, width)
    for (image, x0, y0, x1, y1), picture in zip(boxes, pictures, strict=True):
        images[image, :, y0:y1, x0:x1] = picture[:, y0:y1, x0:x1].to(images.device) / 255
        areas[image, y0:y1, x0:x1] = True
    behind = hidden.index_select(0, canvas.target)
    return replace(canvas, target=canvas.target.masked_fill(behind, len(canvas.rows) - 1))


def draw_occluders(
    random: np.random.Generator, body: Sequence[float], most: int, size: int
) -> list[tuple[int, int, int, int]]:
    """Draw 0 to `most` rectangles (x0, y0, x1, y1) about places in a body's box, cut at a square image's edges."""
    low, high = np.array(body[:2]), np.array(body[2:])
    count = random.integers(most, endpoint=True)
    centers = random.uniform(low, high, (count, 2))
    halves = random.uniform(*OCCLUDER_SIDES, (count, 2)) * (high - low) / 2
    corners = np.concatenate([centers - halves, centers + halves], 1).clip(0, size).round().astype(int)
    return [tuple(row) for row in corners.tolist()]


def draw_window(random: np.random.Generator, crop: float, pad: float) -> tuple[float, float, float]:
    """Draw one image's window (see `Distortion`): up to a share `crop` cut away, or up to `pad` of margin."""
    is_crop = random.random() < 0.5 if crop and pad else bool(crop)
    share = random.uniform(0, crop if is_crop else pad)
    side = 1 - share if is_crop else 1 / (1 - share)
    x, y = random.uniform(-1, 1, 2) * abs(1 - side)
    return side, x, y
