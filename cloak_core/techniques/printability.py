"""The non-printability score: how far colours are from those that a palette has.

Sharif et al., "Accessorize to a Crime" (CCS 2016), in the form of Thys et al., "Fooling automated surveillance cameras"
(CVPR workshops 2019): Sharif's product of the distances to all palette colours vanishes, with its gradient, once there
are more than a few of them.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float

from cloak_core.core.settings import TrainSettings
from cloak_core.core.technique import Technique
from cloak_core.files.identity import sha256_arrays
from cloak_core.sources.bodies.logos.palette import read_palette


class Printability(Technique):
    """Adds the mean distance to the palette to the loss."""

    name = "nps"

    def __init__(self, weight: float, palette: Float[np.ndarray, "P 3"], device: torch.device) -> None:
        self.weight = weight
        self.colors = palette
        self.palette = torch.as_tensor(palette, dtype=torch.float32, device=device)

    def penalty(self, colors: Float[torch.Tensor, "C 3"]) -> tuple[float, Float[torch.Tensor, ""]]:
        """Average the colours' Euclidean distance to the nearest of the palette, sRGB in [0, 1]; at most sqrt(3).

        A colour of the palette itself has gradient 0.
        """
        # Which one is nearest does not need a gradient, and [L, P] of floats is all that is kept at once.
        with torch.no_grad():
            squares = (self.palette**2).sum(dim=1) - 2 * colors @ self.palette.T
            nearest = self.palette[squares.argmin(dim=1)]
        # The root's gradient is infinite at 0; below a millionth of a colour there is none.
        return self.weight, ((colors - nearest) ** 2).sum(dim=1).clamp_min(1e-12).sqrt().mean()

    def content(self) -> dict[str, object]:
        return {"palette": {"colors": len(self.colors), "sha256": sha256_arrays(self.colors)}}


def build(settings: TrainSettings, pattern: object, detectors: object, device: torch.device) -> Printability:
    """Read the palette. InputError: it cannot be read."""
    return Printability(settings.objective.nps_weight, read_palette(settings.objective.palette), device)
