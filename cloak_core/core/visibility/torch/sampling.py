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
from cloak_core.core.visibility.torch.triangles import Triangles, canonical, expand

SIDE = 64
"""Samples along each side of a pixel of too many pieces to resolve exactly."""


def cover(packed: Int64[Tensor, "rows columns"], flat: FlatTriangles, row0: int, column0: int, shift: int) -> None:
    """See `Backend.cover`."""
    _draw(packed, canonical(flat), row0, column0, shift)


def _draw(packed: Int64[Tensor, "rows columns"], triangles: Triangles, row0: int, column0: int, shift: int) -> None:
    """Lower packed depth and id to the nearest triangle's at every sample; see `Backend.cover`."""
    rows, columns = packed.shape
    c0, c1 = _span(triangles.x, shift, column0, columns)
    r0, r1 = _span(triangles.y, shift, row0, rows)
    some = (torch.minimum(c1 - c0, r1 - r0) >= 0).nonzero().view(-1)
    triangles, (c0, c1, r0, r1) = triangles.take(some), (t.index_select(0, some) for t in (c0, c1, r0, r1))
    for owner, down in expand(r1 - r0 + 1):
        for row, across in expand((c1 - c0 + 1).index_select(0, owner)):
            own = owner.index_select(0, row)
            line, column = (r0.index_select(0, own) + down.index_select(0, row)), c0.index_select(0, own) + across
            at = (t * (1 << shift) + (1 << shift) // 2 for t in (column, line))
            key, inside = _packed(triangles, own, *at)
            place = ((line - row0) * columns + column - column0)[inside]
            packed.view(-1).scatter_reduce_(0, place, key[inside], "amin")


def _span(position: Int64[Tensor, "3 N"], shift: int, first: int, count: int) -> tuple[Tensor, Tensor]:
    """Find the first and last sample within triangles' extents along one axis."""
    half = (1 << shift) // 2
    low, high = (position.amin(0) + half - 1) >> shift, (position.amax(0) - half) >> shift
    return low.clamp(min=first), high.clamp(max=first + count - 1)


def _packed(triangles: Triangles, own: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Packed depth and id of each triangle at a sample, and whether it covers the sample, by the top-left rule.

    Edge 0-2 is on the left (or level on top) and owns its samples, edge 0-1 is on the right and does not; edge 1-2
    owns them where it is on the left.
    """
    e1, e2, area = triangles.edges(own, x, y)
    e0, left = area - e1 - e2, (triangles.y[1] > triangles.y[2]).index_select(0, own)
    inside = (e1 >= 0) & (e2 > 0) & ((e0 > 0) | ((e0 == 0) & left))
    depth = (triangles.inverse_depth_at(own, x, y) * (1 << DEPTH_BITS)).to(torch.int64).clamp(0, LIMIT)
    return ((LIMIT - depth) << ID_BITS) | triangles.ids.index_select(0, own), inside


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


def sample_pixel(triangles: Triangles, column: int, row: int, width: int) -> Fragments:
    """Sample triangles in one pixel of an image `width` pixels wide."""
    packed = torch.full((SIDE, SIDE), EMPTY, dtype=torch.int64, device=triangles.ids.device)
    _draw(packed, triangles, row * SIDE, column * SIDE, (GRID // SIDE).bit_length() - 1)
    return merge_samples(packed, SIDE, Window(column, row, column + 1, row + 1), width)
