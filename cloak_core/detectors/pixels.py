"""How a network wants its pixels: order of channels, range, normalisation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

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
        said = ["bgr"] * self.bgr + [f"range={self.range:g}"] * (self.range != 1)
        said += [
            f"{name}={listed[name]}"
            for name, plain in (("mean", 0.0), ("std", 1.0))
            if set(getattr(self, name)) != {plain}
        ]
        return ",".join(said) or "rgb"

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
