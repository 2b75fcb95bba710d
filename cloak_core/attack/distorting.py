"""What cameras and files do to images, differentiably: zoom, crop, margin, tint, blur, JPEG's loss; and things that
stand in the way."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from torch import Tensor

from cloak_core.render.compositing import Canvas, pixels_of

OCCLUDER_SIDES = (0.15, 0.45)
"""Sides of an occluder as shares of the body's box."""
BLOCK = 8
_LUMINANCE = (
    (16, 11, 10, 16, 24, 40, 51, 61),
    (12, 12, 14, 19, 26, 58, 60, 55),
    (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62),
    (18, 22, 37, 56, 68, 109, 103, 77),
    (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101),
    (72, 92, 95, 98, 112, 100, 103, 99),
)
"""JPEG (ITU-T T.81), annex K, table K.1."""
_CHROMINANCE = (
    (17, 18, 24, 47, 99, 99, 99, 99),
    (18, 21, 26, 66, 99, 99, 99, 99),
    (24, 26, 56, 99, 99, 99, 99, 99),
    (47, 66, 99, 99, 99, 99, 99, 99),
    *((99,) * 8,) * 4,
)
"""Table K.2."""
_TO_YCC = ((0.299, 0.587, 0.114), (-0.168736, -0.331264, 0.5), (0.5, -0.418688, -0.081312))
"""JFIF's RGB to Y, Cb, Cr, without the offset of 128."""


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


def zoomed(images: Float[Tensor, "B 3 H W"], factor: Float[Tensor, "B"]) -> Float[Tensor, "B 3 H W"]:
    """Each image enlarged about its centre by its factor, bilinearly, at the same size."""
    scale = torch.zeros(len(images), 2, 3, dtype=images.dtype, device=images.device)
    scale[:, 0, 0] = scale[:, 1, 1] = 1 / factor
    grid = F.affine_grid(scale, list(images.shape), align_corners=False)
    return F.grid_sample(images, grid, padding_mode="reflection", align_corners=False)


def windowed(images: Float[Tensor, "B 3 H W"], window: Float[Tensor, "B 3"]) -> Float[Tensor, "B 3 H W"]:
    """What each image's window shows of it, bilinearly, at the same size; mid-grey beyond its edges.

    window: side (below 1 a crop, above 1 a margin) and centre (x, y), see `Distortion`.
    """
    place = torch.zeros(len(images), 2, 3, dtype=images.dtype, device=images.device)
    place[:, 0, 0] = place[:, 1, 1] = window[:, 0]
    place[:, :, 2] = window[:, 1:]
    grid = F.affine_grid(place, list(images.shape), align_corners=False)
    return F.grid_sample(images - 0.5, grid, padding_mode="zeros", align_corners=False) + 0.5


def tinted(images: Float[Tensor, "B 3 H W"], factors: Float[Tensor, "B 4"]) -> Float[Tensor, "B 3 H W"]:
    """Channels multiplied by the first three factors, then the distance from each pixel's grey by the last; clamped.

    The gradient passes the clamp within [0, 1].
    """
    images = images * factors[:, :3, None, None]
    luma = torch.tensor(_TO_YCC[0], dtype=images.dtype, device=images.device).view(1, 3, 1, 1)
    grey = (images * luma).sum(1, keepdim=True)
    return torch.lerp(grey.expand_as(images), images, factors[:, 3].view(-1, 1, 1, 1)).clamp(0, 1)


def blurred(images: Float[Tensor, "B 3 H W"], sigma: Float[Tensor, "B"]) -> Float[Tensor, "B 3 H W"]:
    """A Gaussian blur of each image with its own standard deviation in pixels, cut at 3 pixels; edges are repeated."""
    batch, channels, height, width = images.shape
    place = torch.arange(-3.0, 4.0, device=images.device)
    kernel = torch.exp(-0.5 * (place / sigma.clamp(min=1e-3)[:, None]) ** 2)
    kernel = (kernel / kernel.sum(1, keepdim=True)).repeat_interleave(channels, 0)
    flat = F.pad(images, (3, 3, 3, 3), mode="replicate").reshape(1, batch * channels, height + 6, width + 6)
    flat = F.conv2d(flat, kernel[:, None, :, None], groups=batch * channels)
    flat = F.conv2d(flat, kernel[:, None, None, :], groups=batch * channels)
    return flat.view(images.shape)


def through_jpeg(images: Float[Tensor, "B 3 H W"], quality: Float[Tensor, "B"]) -> Float[Tensor, "B 3 H W"]:
    """What JPEG of each image's quality leaves of it: blocks of 8 x 8 in YCbCr, DCT coefficients rounded to its tables.

    Without chroma subsampling. The gradient passes rounding as if it were not there. Clamped to [0, 1].
    """
    height, width = images.shape[2:]
    padded = F.pad(images, (0, -width % BLOCK, 0, -height % BLOCK), mode="replicate")
    to_ycc = torch.tensor(_TO_YCC, dtype=images.dtype, device=images.device)
    ycc = torch.einsum("kc,bchw->bkhw", to_ycc, 255 * padded) - 128 * images.new_tensor([1.0, 0, 0]).view(3, 1, 1)
    cosines = _cosines(images)
    blocks = ycc.unflatten(3, (-1, BLOCK)).unflatten(2, (-1, BLOCK))  # [B, 3, rows, 8, columns, 8]
    coefficients = torch.einsum("ui,bkricj,vj->bkrucv", cosines, blocks, cosines)
    step = _quantisation(images, quality)[:, :, None, :, None, :]
    scaled = coefficients / step
    rounded = scaled + (scaled.round() - scaled).detach()
    blocks = torch.einsum("ui,bkrucv,vj->bkricj", cosines, rounded * step, cosines)
    ycc = blocks.reshape(ycc.shape) + 128 * images.new_tensor([1.0, 0, 0]).view(3, 1, 1)
    rgb = torch.einsum("ck,bkhw->bchw", torch.linalg.inv(to_ycc), ycc) / 255
    return rgb[:, :, :height, :width].clamp(0, 1)


def _cosines(like: Tensor) -> Float[Tensor, "8 8"]:
    """The orthonormal discrete cosine transform."""
    k = torch.arange(BLOCK, dtype=torch.float64)
    matrix = torch.cos(torch.pi * (2 * k + 1) * k[:, None] / (2 * BLOCK)) * (2 / BLOCK) ** 0.5
    matrix[0] /= 2**0.5
    return matrix.to(like)


def _quantisation(like: Tensor, quality: Float[Tensor, "B"]) -> Float[Tensor, "B 3 8 8"]:
    """The tables of annex K scaled as libjpeg does for a quality of 1..100."""
    tables = torch.tensor([_LUMINANCE, _CHROMINANCE, _CHROMINANCE], dtype=like.dtype, device=like.device)
    percent = torch.where(quality < 50, 5000 / quality, 200 - 2 * quality)
    return (tables * percent.view(-1, 1, 1, 1) / 100 + 0.5).floor().clamp(1, 255)


def occluded(
    canvas: Canvas, boxes: Sequence[tuple[int, int, int, int, int]], pictures: Sequence[UInt8[Tensor, "3 H W"]]
) -> Canvas:
    """The canvas with rectangles before its bodies, each cut from its picture at the same place.

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
    """0 to `most` rectangles (x0, y0, x1, y1), their centres in a body's box, cut at the edges of a square image."""
    low, high = np.array(body[:2]), np.array(body[2:])
    count = random.integers(most, endpoint=True)
    centers = random.uniform(low, high, (count, 2))
    halves = random.uniform(*OCCLUDER_SIDES, (count, 2)) * (high - low) / 2
    corners = np.concatenate([centers - halves, centers + halves], 1).clip(0, size).round().astype(int)
    return [tuple(row) for row in corners.tolist()]


def draw_window(random: np.random.Generator, crop: float, pad: float) -> tuple[float, float, float]:
    """One image's window (see `Distortion`): up to a share `crop` cut away, or up to `pad` of it margin, anywhere."""
    is_crop = random.random() < 0.5 if crop and pad else bool(crop)
    share = random.uniform(0, crop if is_crop else pad)
    side = 1 - share if is_crop else 1 / (1 - share)
    x, y = random.uniform(-1, 1, 2) * abs(1 - side)
    return side, x, y
