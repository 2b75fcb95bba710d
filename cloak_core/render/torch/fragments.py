"""Samples to fragments, in torch: the visible samples of every (pixel, triangle), merged."""

from __future__ import annotations

import torch
from torch import Tensor

from cloak_core.render.packing import EMPTY, ID_BITS, triangle_ids
from cloak_core.render.types import Fragments, Window


def merge_samples(packed: Tensor, grid: int, window: Window, width: int) -> Fragments:
    """See `Backend.merge_samples`."""
    row, column = (packed != EMPTY).nonzero(as_tuple=True)
    triangle = triangle_ids(packed[row, column])
    row, column = row + window.y0 * grid, column + window.x0 * grid
    pixel = torch.div(row, grid, rounding_mode="floor") * width + torch.div(column, grid, rounding_mode="floor")
    entry, owner, count = torch.unique(pixel << ID_BITS | triangle, return_inverse=True, return_counts=True)
    x, y = (
        torch.zeros(len(entry), dtype=torch.float64, device=packed.device).index_add_(0, owner, (t + 0.5) / grid)
        / count
        for t in (column.double(), row.double())
    )
    area = count.to(torch.float32) / (grid * grid)
    return Fragments(entry >> ID_BITS, entry & ((1 << ID_BITS) - 1), area, x, y)
