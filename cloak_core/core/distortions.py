"""What makes the images of a batch harder, each by its own seed: grey parts of the logo, crop or margin, and blur."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cloak_core.core.filters import blurred, windowed
from cloak_core.core.settings.components import AugmentationSettings

_CUTOUT, _WINDOW, _BLUR = 2, 3, 6
"""Streams of random numbers."""


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
