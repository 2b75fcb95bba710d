"""What cameras and files do to pictures, differentiably: blur, JPEG's loss, a crop or a margin; and how it is drawn.

Training makes the images of a batch harder by these, each by its own seed, and by grey parts of the logo. A defence may
stand before a detector with the same (`detectors.defended`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cloak_core.core.settings.components import AugmentationSettings

_CUTOUT, _WINDOW, _BLUR = 2, 3, 6
"""Streams of random numbers."""
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
TO_YCC = ((0.299, 0.587, 0.114), (-0.168736, -0.331264, 0.5), (0.5, -0.418688, -0.081312))
"""JFIF's RGB to Y, Cb, Cr, without the offset of 128."""


def windowed(images: Float[Tensor, "B 3 H W"], window: Float[Tensor, "B 3"]) -> Float[Tensor, "B 3 H W"]:
    """Show what lies in each image's window, bilinearly, at the same size; mid-grey beyond the edges.

    window: side (below 1 a crop, above 1 a margin) and centre (x, y), see `Distortion`.
    """
    place = torch.zeros(len(images), 2, 3, dtype=images.dtype, device=images.device)
    place[:, 0, 0] = place[:, 1, 1] = window[:, 0]
    place[:, :, 2] = window[:, 1:]
    grid = F.affine_grid(place, list(images.shape), align_corners=False)
    return F.grid_sample(images - 0.5, grid, padding_mode="zeros", align_corners=False) + 0.5


def blurred(images: Float[Tensor, "B 3 H W"], sigma: Float[Tensor, " B"], reach: int = 3) -> Float[Tensor, "B 3 H W"]:
    """Blur each image by a Gaussian of its own standard deviation, pixels.

    The kernel is cut at `reach` pixels; edges are repeated.
    """
    batch, channels, height, width = images.shape
    place = torch.arange(-float(reach), reach + 1, device=images.device)
    kernel = torch.exp(-0.5 * (place / sigma.clamp(min=1e-3)[:, None]) ** 2)
    kernel = (kernel / kernel.sum(1, keepdim=True)).repeat_interleave(channels, 0)
    flat = F.pad(images, (reach,) * 4, mode="replicate").reshape(
        1, batch * channels, height + 2 * reach, width + 2 * reach
    )
    flat = F.conv2d(flat, kernel[:, None, :, None], groups=batch * channels)
    flat = F.conv2d(flat, kernel[:, None, None, :], groups=batch * channels)
    return flat.view(images.shape)


def through_jpeg(images: Float[Tensor, "B 3 H W"], quality: Float[Tensor, " B"]) -> Float[Tensor, "B 3 H W"]:
    """Simulate JPEG of each image's quality: 8 x 8 DCT blocks in YCbCr, coefficients rounded by its tables.

    Without chroma subsampling. The gradient passes rounding as if it were not there. Clamped to [0, 1].
    """
    height, width = images.shape[2:]
    padded = F.pad(images, (0, -width % BLOCK, 0, -height % BLOCK), mode="replicate")
    to_ycc = torch.tensor(TO_YCC, dtype=images.dtype, device=images.device)
    ycc = torch.einsum("kc,bchw->bkhw", to_ycc, 255 * padded) - 128 * images.new_tensor([1.0, 0, 0]).view(3, 1, 1)
    # The orthonormal discrete cosine transform.
    k = torch.arange(BLOCK, dtype=torch.float64)
    cosines = torch.cos(torch.pi * (2 * k + 1) * k[:, None] / (2 * BLOCK)) * (2 / BLOCK) ** 0.5
    cosines[0] /= 2**0.5
    cosines = cosines.to(images)
    blocks = ycc.unflatten(3, (-1, BLOCK)).unflatten(2, (-1, BLOCK))  # [B, 3, rows, 8, columns, 8]
    coefficients = torch.einsum("ui,bkricj,vj->bkrucv", cosines, blocks, cosines)
    # The tables of annex K, scaled as libjpeg does for a quality of 1..100.
    tables = torch.tensor([_LUMINANCE, _CHROMINANCE, _CHROMINANCE], dtype=images.dtype, device=images.device)
    percent = torch.where(quality < 50, 5000 / quality, 200 - 2 * quality)
    step = (tables * percent.view(-1, 1, 1, 1) / 100 + 0.5).floor().clamp(1, 255)[:, :, None, :, None, :]
    scaled = coefficients / step
    rounded = scaled + (scaled.round() - scaled).detach()
    blocks = torch.einsum("ui,bkrucv,vj->bkricj", cosines, rounded * step, cosines)
    ycc = blocks.reshape(ycc.shape) + 128 * images.new_tensor([1.0, 0, 0]).view(3, 1, 1)
    rgb = torch.einsum("ck,bkhw->bchw", torch.linalg.inv(to_ycc), ycc) / 255
    return rgb[:, :, :height, :width].clamp(0, 1)


def cut_out(seeds: Int[np.ndarray, " B"], most: float, centres: Float[np.ndarray, "C D"]) -> Bool[np.ndarray, "B C"]:
    """Choose the colours that are grey in each image: those nearest to a random one, up to a share `most`.

    centres: where the colours lie, metres. After DeVries and Taylor, "Improved regularization of convolutional neural
    networks with cutout" (arXiv 1708.04552).
    """
    hidden = np.zeros((len(seeds), len(centres)), bool)
    for row, seed in zip(hidden, seeds, strict=True):
        random = np.random.default_rng([seed, _CUTOUT])
        about = centres[random.integers(len(row))]
        count = round(random.uniform(0, most) * len(row))
        apart = ((centres - about) ** 2).sum(1)
        row[np.argsort(apart, kind="stable")[:count]] = True
    return hidden


@dataclass(frozen=True, eq=False)
class Distortion:
    """What happens to B finished images."""

    windows: Float[Tensor, "B 3"] | None = None
    """What is shown of each: side and centre (x, y), in units in which the image's edges are at -1 and 1; None: all."""
    deviations: Float[Tensor, " B"] | None = None
    """Standard deviations of the blur, pixels; None: no blur."""

    @staticmethod
    def draw(seeds: Int[np.ndarray, " B"], settings: AugmentationSettings, device: torch.device) -> Distortion:
        """Draw what happens to the images of these seeds."""
        windows = deviations = None
        if settings.crop or settings.pad:
            drawn = [draw_window(np.random.default_rng([s, _WINDOW]), settings.crop, settings.pad) for s in seeds]
            windows = torch.from_numpy(np.array(drawn).reshape(-1, 3)).float().to(device, non_blocking=True)
        if settings.blur:
            drawn = [np.random.default_rng([seed, _BLUR]).uniform(0, settings.blur) for seed in seeds]
            deviations = torch.from_numpy(np.array(drawn)).float().to(device, non_blocking=True)
        return Distortion(windows, deviations)

    def __call__(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        """Distort the images, differentiably; a camera's lens comes after where it looks."""
        if self.windows is not None:
            images = windowed(images, self.windows)
        return images if self.deviations is None else blurred(images, self.deviations)

    def boxes(self, boxes: Float[Tensor, "B 4"], height: int, width: int) -> Float[Tensor, "B 4"]:
        """Move boxes (xyxy, pixels) with the images of this size, and clip them to what is still shown."""
        size = boxes.new_tensor([width, height] * 2)
        moved = 2 * boxes / size - 1
        if self.windows is not None:
            moved = (moved - self.windows[:, [1, 2, 1, 2]]) / self.windows[:, :1]
        return torch.minimum(((moved + 1) * size / 2).clamp(min=0), size)


def draw_window(random: np.random.Generator, crop: float, pad: float) -> tuple[float, float, float]:
    """Draw one image's window: up to a share `crop` cut away, or up to `pad` of margin; side, centre x, centre y."""
    is_crop = random.random() < 0.5 if crop and pad else bool(crop)
    amount = random.uniform(0, crop if is_crop else pad)
    side = 1 - amount if is_crop else 1 / (1 - amount)
    x, y = random.uniform(-1, 1, 2) * abs(1 - side)
    return side, x, y
