"""Changes of brightness: of the logo's colours, or of all that a body's pixels show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

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
    """Amplitude of uniform noise, +-."""
    seed: int = 0
    """Of the noise, for the whole batch."""
    on: Literal["logo", "render"] = "logo"
    """Either the logo's colours, noise per face and channel, or the body's pixels, noise per pixel and channel."""

    def of_colors(self, colors: Float32[Tensor, "*B L 3"]) -> Float32[Tensor, "B L 3"]:
        """The logo's colours, changed for each image."""
        colors = colors * self.contrast.view(-1, 1, 1) + self.brightness.view(-1, 1, 1)
        return colors + self.draw_noise(colors.shape, colors.device) if self.noise else colors

    def draw_noise(self, shape: Sequence[int], device: torch.device) -> Tensor:
        """The batch's noise; the same numbers for the same shape and kind of device."""
        generator = torch.Generator(device=device).manual_seed(self.seed)
        return torch.rand(shape, generator=generator, device=device).mul_(2).sub_(1).mul_(self.noise)
