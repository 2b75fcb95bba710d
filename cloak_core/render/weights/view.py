"""A view as a sparse matrix: what rasterizing ends in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float32, Int64
from torch import Tensor


@dataclass(frozen=True, eq=False)
class View:
    """One pose seen by one camera: N covered pixels, E fragments, as a sparse matrix pixels x faces (CSR)."""

    height: int
    width: int
    pixels: Int64[Tensor, " N"]
    """Flat index y * W + x, ascending."""
    coverage: Float32[Tensor, " N"]
    """Share of the pixel that the body covers, in (0, 1]."""
    specular: Float32[Tensor, " N"]
    """Highlight, the same in all channels."""
    crow: Int64[Tensor, " N1"]
    """N + 1 row offsets."""
    face: Int64[Tensor, " E"]
    weight: Float32[Tensor, " E"]
    """What a face's colour is multiplied by: its share of the pixel times its light."""
    uv: Float32[Tensor, "2 E"] | None = None
    """Where bodies have textures: texture coordinates in the middle of what is seen of the triangle in the pixel;
    there is an entry for each triangle of a face then."""

    @cached_property
    def box(self) -> tuple[int, int, int, int]:
        """(x0, y0, x1, y1) of the pixels at least half covered, x1 and y1 exclusive; zeros where there are none."""
        inside = self.pixels[self.coverage >= 0.5]
        if not len(inside):
            return 0, 0, 0, 0
        y = torch.div(inside, self.width, rounding_mode="floor")
        x = inside - y * self.width
        x0, y0, x1, y1 = torch.stack([x.min(), y.min(), x.max(), y.max()]).tolist()
        return x0, y0, x1 + 1, y1 + 1
