"""Sharpness-aware minimisation: colours whose neighbours hide as well, which carry to detectors that nobody asked.

SAM (Foret et al., "Sharpness-Aware Minimization for Efficiently Improving Generalization", ICLR 2021): each update
follows the gradient at the worst place nearby, which is a step up the slope. That flat minima carry to strangers is
what CWA found for images (Chen et al., "Rethinking Model Ensemble in Transfer-based Adversarial Attacks", ICLR 2024).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from jaxtyping import Float

from cloak_core.core.settings.values import Bounds
from cloak_core.core.technique import Setup, Technique
from cloak_core.files.lazy import Lazy

torch = Lazy("torch")


@dataclass(frozen=True, kw_only=True)
class SamSettings:
    sam: Annotated[float, Bounds(0, 10)] = 0.0
    """Sharpness-aware minimisation (SAM, Foret et al., ICLR 2021): follow the gradient this far up the slope, the root
    mean square over the free parameters, so that what is found carries further; a step takes twice as long. 0 follows
    the gradient where the colours are."""


class Sam(Technique):
    """Says how far up the slope the gradient is taken."""

    group = "optimization"
    settings = SamSettings
    bars_search = True

    def __init__(self, radius: float) -> None:
        """radius: root mean square of the way, over all free parameters."""
        self.radius = radius

    @classmethod
    def build(cls, setup: Setup) -> Sam | None:
        radius = setup.settings.optimization.sam
        return cls(radius) if radius else None

    def aside(self, gradient: Float[torch.Tensor, "P 3"]) -> Float[torch.Tensor, "P 3"]:
        # By the largest first: squares of very small or large gradients are no numbers any more.
        unit = gradient / gradient.abs().max().clamp_min(torch.finfo(gradient.dtype).tiny)
        return unit * (self.radius * gradient.numel() ** 0.5 / unit.norm().clamp_min(1))


TECHNIQUE = Sam
