"""The nearest triangle at each sample, and samples merged to fragments, in torch.

Every triangle is tested at every sample in its bounding box.
"""

from __future__ import annotations

import torch
from jaxtyping import Int64
from torch import Tensor

from cloak_core.core.view import FlatTriangles, Fragments, Window
from cloak_core.core.visibility.packing import DEPTH_BITS, EMPTY, ID_BITS, LIMIT, triangle_ids
from cloak_core.core.visibility.screen import GRID
from cloak_core.core.visibility.torch.triangles import Triangles, canonical, expand_boxes

SIDE = 64
"""Samples along each side of a pixel of too many pieces to resolve exactly."""


def cover(packed: Int64[Tensor, "rows columns"], flat: FlatTriangles, row0: int, column0: int, shift: int) -> None:
    """See `Backend.cover`."""
    _draw(packed, canonical(flat), row0, column0, shift)


def _draw(packed: Int64[Tensor, "rows columns"], triangles: Triangles, row0: int, column0: int, shift: int) -> None:
    """Lower packed depth and id to the nearest triangle's at every sample; see `Backend.cover`."""
    rows, columns = packed.shape
    low, size = _span(triangles, shift, (column0, row0), (columns, rows))
    for own, place in expand_boxes(low, size):
        key, inside = _packed(triangles, own, place * (1 << shift) + (1 << shift) // 2)
        column, row = place
        flat = (row - row0) * columns + (column - column0)
        packed.view(-1).scatter_reduce_(0, flat, torch.where(inside, key, EMPTY), "amin")


def _span(
    triangles: Triangles, shift: int, first: tuple[int, int], count: tuple[int, int]
) -> tuple[Int64[Tensor, "xy=2 N"], Int64[Tensor, "xy=2 N"]]:
    """Find the first sample within triangles' extents, along both axes, and the number of samples."""
    least, most = torch.aminmax(triangles.corners, dim=1)
    half = (1 << shift) // 2
    low, stop = (least + (half - 1)) >> shift, (most + half) >> shift
    for axis in range(2):
        low[axis].clamp_(min=first[axis])
        stop[axis].clamp_(max=first[axis] + count[axis])
    return low, (stop - low).clamp(min=0)


def _packed(triangles: Triangles, own: Tensor, place: Int64[Tensor, "xy=2 M"]) -> tuple[Tensor, Tensor]:
    """Packed depth and id of each triangle at a sample, and whether it covers the sample, by the top-left rule.

    Edge 0-2 is on the left (or level on top) and owns its samples, edge 0-1 is on the right and does not; edge 1-2
    owns them where it is on the left.
    """
    edges, area = triangles.edges(own, place)
    e1, e2 = edges
    y1, y2 = triangles.corners[1, 1:].index_select(1, own)
    inside = (e1 >= 0) & (e2 > 0) & (area - e1 - e2 + (y1 > y2) > 0)
    depth = (triangles.inverse_depth_at(own, edges, area) * (1 << DEPTH_BITS)).to(torch.int64).clamp(0, LIMIT)
    return torch.add(triangles.ids.index_select(0, own), LIMIT - depth, alpha=1 << ID_BITS), inside


def merge_samples(packed: Tensor, grid: int, window: Window, width: int) -> Fragments:
    """See `Backend.merge_samples`."""
    sample = (packed != EMPTY).nonzero()  # rows and columns
    triangle = triangle_ids(packed[sample[:, 0], sample[:, 1]])
    row, column = torch.div(sample, grid, rounding_mode="floor").T
    pixel = torch.add(column, row, alpha=width)
    first = window.y0 * width + window.x0
    if grid == 1:  # every sample is a fragment of its own, in order already: a GPU sorts in twenty launches
        y, x = sample.T.double() + 0.5
        area = torch.ones(len(pixel), dtype=torch.float32, device=packed.device)
        return Fragments(pixel + first, triangle, area, x + window.x0, y + window.y0)
    entry, owner, count = torch.unique(
        torch.add(triangle, pixel, alpha=1 << ID_BITS), return_inverse=True, return_counts=True
    )
    total = torch.zeros(len(entry), 2, dtype=torch.float64, device=packed.device).index_add_(0, owner, sample.double())
    y, x = (total / (count * grid).unsqueeze(1)).T + 0.5 / grid
    area = count.to(torch.float32) / (grid * grid)
    return Fragments((entry >> ID_BITS) + first, entry & ((1 << ID_BITS) - 1), area, x + window.x0, y + window.y0)


def sample_pixel(triangles: Triangles, column: int, row: int, width: int) -> Fragments:
    """Sample triangles in one pixel of an image `width` pixels wide."""
    packed = torch.full((SIDE, SIDE), EMPTY, dtype=torch.int64, device=triangles.ids.device)
    _draw(packed, triangles, row * SIDE, column * SIDE, (GRID // SIDE).bit_length() - 1)
    return merge_samples(packed, SIDE, Window(column, row, column + 1, row + 1), width)
