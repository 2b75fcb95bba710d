"""Cutout on the logo: in each image a part of it is grey, so that no colour depends on the others.

After DeVries and Taylor, "Improved regularization of convolutional neural networks with cutout" (arXiv 1708.04552).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float, Int

from cloak_core.core.settings.values import Bounds
from cloak_core.core.technique import Setup, Technique

_STREAM = 2


@dataclass(frozen=True, kw_only=True)
class CutoutSettings:
    cutout: Annotated[float, Bounds(0, 1)] = 0.0
    """Paint up to this share of the logo's faces grey in each image, around one face, so that no colour depends on the
    others; 0 switches it off."""


class Cutout(Technique):
    """Hides the colours nearest to a random one."""

    group = "augmentation"
    settings = CutoutSettings

    def __init__(self, most: float, centres: Float[np.ndarray, "C D"]) -> None:
        """most: largest fraction of the colours; centres: where they lie, metres."""
        self.most = most
        self.centres = centres

    @classmethod
    def build(cls, setup: Setup) -> Cutout | None:
        most = setup.settings.augmentation.cutout
        return cls(most, setup.pattern.centres) if most else None

    def hidden(self, seeds: Int[np.ndarray, " B"]) -> Bool[np.ndarray, "B C"]:
        hidden = np.zeros((len(seeds), len(self.centres)), bool)
        for row, seed in zip(hidden, seeds, strict=True):
            random = np.random.default_rng([seed, _STREAM])
            about = self.centres[random.integers(len(row))]
            count = round(random.uniform(0, self.most) * len(row))
            apart = ((self.centres - about) ** 2).sum(1)
            row[np.argsort(apart, kind="stable")[:count]] = True
        return hidden


TECHNIQUE = Cutout
