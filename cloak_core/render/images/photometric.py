"""Changes of brightness of all that a body's pixels show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.scene.cameras import Number


@dataclass(frozen=True)
class Photometric:
    """Changes of brightness for B images: value * contrast + brightness + noise."""

    contrast: Float32[Tensor, " B"]
    brightness: Float32[Tensor, " B"]
    noise: Number = 0.0
    """Amplitude of uniform noise per pixel and channel, +-."""
    seed: int = 0
    """Of the noise, for the whole batch."""

    def draw_noise(self, shape: Sequence[int], device: torch.device) -> Tensor:
        """The batch's noise; the same numbers for the same shape and kind of device."""
        generator = torch.Generator(device=device).manual_seed(self.seed)
        return torch.rand(shape, generator=generator, device=device).mul_(2).sub_(1).mul_(self.noise)
