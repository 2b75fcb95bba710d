"""A picture worn once, on the chest."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from cloak_core.core.linear import SparseMap
from cloak_core.core.logo import Cover
from cloak_core.core.places import Places
from cloak_core.patterns.cloth import ClothPattern
from cloak_core.patterns.footprint import squares_under


@dataclass(frozen=True, eq=False)
class ChestPattern(ClothPattern):
    """A picture that does not repeat. The faces that may wear it show their own colours beside it."""

    corner: tuple[float, float] = (0.0, 0.0)
    """Of its left upper corner on the cloth, metres right and down."""
    period = None

    def map(self, places: Places, offset: tuple[float, float] = (0.0, 0.0)) -> SparseMap:
        """See `Pattern`: a place wears it whose middle lies in the picture; what reaches beyond is cut off."""
        grid = self.grid
        size = torch.tensor([grid.metres, grid.square * grid.rows], device=places.at.device).unsqueeze(1)
        at = places.at - torch.tensor(self.corner, device=places.at.device).unsqueeze(1)
        inside = ((at >= 0) & (at < size)).all(0) & (places.face >= 0)
        low, high = (at - places.extent / 2).clamp(min=0), torch.minimum(at + places.extent / 2, size)
        return squares_under((low + high) / 2, high - low, inside, grid.square, grid.rows, grid.columns)

    def on(self, cover: Cover) -> ChestPattern:
        return self  # it stays on the chest

    @property
    def layout(self) -> tuple:
        return *super().layout, self.corner
