"""Crop and margin: the finished image is cut or shrunk, so that colours work at any place and size in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int

from cloak_core.core.settings.values import Bounds
from cloak_core.core.technique import Distortion, Setup, Technique
from cloak_core.files.lazy import Lazy

torch = Lazy("torch")
_STREAM = 3


@dataclass(frozen=True, kw_only=True)
class WindowSettings:
    crop: Annotated[float, Bounds(0, 0.9)] = 0.0
    """Cut away up to this share of the finished image's width and height, and enlarge the rest."""
    pad: Annotated[float, Bounds(0, 0.9)] = 0.0
    """Shrink the finished image into a grey margin of up to this share of the width and height. With --crop, too, each
    image gets one of the two."""


class Window(Technique):
    """Shows a window of each image, or the image within one."""

    group = "augmentation"
    settings = WindowSettings

    def __init__(self, crop: float, pad: float) -> None:
        self.crop, self.pad = crop, pad

    @classmethod
    def build(cls, setup: Setup) -> Window | None:
        crop, pad = setup.settings.augmentation.crop, setup.settings.augmentation.pad
        return cls(crop, pad) if crop or pad else None

    def distortion(self, seeds: Int[np.ndarray, " B"], device: torch.device) -> Windows:
        drawn = [draw_window(np.random.default_rng([seed, _STREAM]), self.crop, self.pad) for seed in seeds]
        windows = torch.from_numpy(np.array(drawn).reshape(-1, 3)).float()
        return Windows(windows.to(device, non_blocking=True))


@dataclass(frozen=True, eq=False)
class Windows(Distortion):
    """What is shown of each of B images."""

    windows: Float[torch.Tensor, "B 3"]
    """Side and centre (x, y), in units in which the image's edges are at -1 and 1."""

    def __call__(self, images: Float[torch.Tensor, "B 3 H W"]) -> Float[torch.Tensor, "B 3 H W"]:
        from cloak_core.core.filters import windowed

        return windowed(images, self.windows)

    def moved(self, boxes: Float[torch.Tensor, "B 4"]) -> Float[torch.Tensor, "B 4"]:
        return (boxes - self.windows[:, [1, 2, 1, 2]]) / self.windows[:, :1]


def draw_window(random: np.random.Generator, crop: float, pad: float) -> tuple[float, float, float]:
    """Draw one image's window: up to a share `crop` cut away, or up to `pad` of margin; side, centre x, centre y."""
    is_crop = random.random() < 0.5 if crop and pad else bool(crop)
    amount = random.uniform(0, crop if is_crop else pad)
    side = 1 - amount if is_crop else 1 / (1 - amount)
    x, y = random.uniform(-1, 1, 2) * abs(1 - side)
    return side, x, y


TECHNIQUE = Window
