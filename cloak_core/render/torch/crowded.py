"""A pixel of more pieces than can be resolved exactly in bounded time: 64 x 64 samples, in torch."""

from __future__ import annotations

import torch

from cloak_core.render.packing import EMPTY
from cloak_core.render.screen import GRID
from cloak_core.render.torch.fragments import merge_samples
from cloak_core.render.torch.sampling import cover_triangles
from cloak_core.render.torch.triangles import Triangles
from cloak_core.render.types import Fragments, Window

SIDE = 64
"""Samples along each side of a crowded pixel."""
_SHIFT = (GRID // SIDE).bit_length() - 1


def sample_pixel(triangles: Triangles, column: int, row: int, width: int) -> Fragments:
    """Sample triangles in one pixel of an image `width` pixels wide."""
    packed = torch.full((SIDE, SIDE), EMPTY, dtype=torch.int64, device=triangles.ids.device)
    cover_triangles(packed, triangles, row * SIDE, column * SIDE, _SHIFT)
    return merge_samples(packed, SIDE, Window(column, row, column + 1, row + 1), width)
