"""Settings of `attack.self_ensemble`: how training sees the detectors that it asks; evaluation never does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cloak_core.attack.settings.values import Bounds


@dataclass(frozen=True, kw_only=True)
class SurrogateSettings:
    """What makes many of each detector, so that colours do not hang on one network's peculiarities.

    Drawn anew for each image from (seed, step); the detector itself stays as it is.
    """

    shake: Annotated[float, Bounds(0, 1)] = 0.0
    """Multiply residual branches by up to 1 ± this, as T-SEA's ShakeDrop (CVPR 2023); 0 switches it off."""
    random_depth: Annotated[float, Bounds(0, 1, "[)")] = 0.0
    """Probability that a residual branch is left out, for each image."""
    activation_noise: Annotated[float, Bounds(0, 1, "[)")] = 0.0
    """Multiply each channel of a convolution's output by up to 1 ± this; also for networks without residuals."""

    @property
    def on(self) -> bool:
        return bool(self.shake or self.random_depth or self.activation_noise)
