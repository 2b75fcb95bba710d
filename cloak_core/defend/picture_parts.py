"""Parts of backgrounds and photographs: pictures that hardening shows beside people in cloaks."""

from __future__ import annotations

import numpy as np
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from cloak_core.scene.backdrops.backgrounds import Backgrounds

FINER, LEAST_PART = 2, 0.4
"""Pictures are taken from photographs decoded this many times finer, of at least this share of their side: a detector
that learns whole photographs by heart reports more in the parts of others."""


class PictureParts:
    """Square parts of backgrounds and, where there are some, of photographs, `size` pixels wide."""

    def __init__(self, backgrounds: Backgrounds, photographs: Backgrounds | None, size: int) -> None:
        self.backgrounds, self.photographs, self.size = backgrounds, photographs, size

    def draw(self, rng: np.random.Generator, photograph: bool) -> tuple[Float[Tensor, "3 H W"], bool]:
        """A part of a photograph, where there are some, or of a background; and whether people may be in it."""
        people = self.photographs is not None and photograph
        source, side = self.photographs if people else self.backgrounds, FINER * self.size
        whole = source.image(int(rng.integers(len(source))), (side, side)).float() / 255
        shown = int(self.size * rng.uniform(LEAST_PART, 1) * FINER)
        y, x = (int(rng.integers(side - shown + 1)) for _ in range(2))
        part = whole[None, :, y : y + shown, x : x + shown]
        drawn = F.interpolate(part, (self.size, self.size), mode="bilinear", antialias=True)
        return drawn[0].clamp(0, 1), people
