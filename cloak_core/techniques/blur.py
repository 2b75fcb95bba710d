"""Blur, a baseline: one of the transformations over which EOT takes the expectation (Athalye et al., ICML 2018)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int

from cloak_core.core.settings.values import Bounds
from cloak_core.core.technique import Distortion, Setup, Technique
from cloak_core.files.lazy import Lazy

torch = Lazy("torch")
_STREAM = 6


@dataclass(frozen=True, kw_only=True)
class BlurSettings:
    blur: Annotated[float, Bounds(0, 2)] = 0.0
    """Baseline (EOT, Athalye et al., ICML 2018): blur the finished image by a Gaussian of at most this standard
    deviation, pixels; 0 switches it off."""


class Blur(Technique):
    """Blurs each finished image by its own amount."""

    group = "augmentation"
    settings = BlurSettings
    order = 1  # a camera's lens comes after where it looks

    def __init__(self, most: float) -> None:
        self.most = most

    @classmethod
    def build(cls, setup: Setup) -> Blur | None:
        most = setup.settings.augmentation.blur
        return cls(most) if most else None

    def distortion(self, seeds: Int[np.ndarray, " B"], device: torch.device) -> Blurred:
        drawn = np.array([np.random.default_rng([seed, _STREAM]).uniform(0, self.most) for seed in seeds])
        return Blurred(torch.from_numpy(drawn).float().to(device, non_blocking=True))


@dataclass(frozen=True, eq=False)
class Blurred(Distortion):
    """How much each of B images is blurred."""

    deviations: Float[torch.Tensor, " B"]
    """Pixels."""

    def __call__(self, images: Float[torch.Tensor, "B 3 H W"]) -> Float[torch.Tensor, "B 3 H W"]:
        from cloak_core.core.filters import blurred

        return blurred(images, self.deviations)


TECHNIQUE = Blur
