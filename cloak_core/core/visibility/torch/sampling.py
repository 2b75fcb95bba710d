"""The nearest triangle at each sample, and samples merged to fragments, in torch.

Every triangle is tested at every sample in its bounding box; on CUDA one Triton kernel does that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from cloak_core.core.view import FlatTriangles, Fragments, Window
from cloak_core.core.visibility.compiled import use_kernels
from cloak_core.core.visibility.screen import DEPTH_BITS, EMPTY, ID_BITS, LIMIT, triangle_ids

CHUNK = 1 << 16
"""Pairs of triangle and sample worked on at once on the CPU; elsewhere, with slow starts and much memory, 64 times."""


@dataclass(frozen=True)
class Triangles:
    """N triangles with area: corner 0 is the topmost one (of two the right one), the others follow clockwise.

    Edge functions 1 and 2 are integers, A (twice the area) at their corner, 0 along the opposite edge.
    """

    corners: Int64[Tensor, "xy=2 3 N"]
    inverse_depth: Float64[Tensor, "3 N"]
    ids: Int64[Tensor, " N"]


def cover(packed: Int64[Tensor, "rows columns"], flat: FlatTriangles, row0: int, column0: int, shift: int) -> None:
    """Lower packed depth and id to the nearest triangle's, at the samples from row0 and column0 on.

    shift: there are 2^shift grid units between samples.
    """
    if use_kernels(packed.device):
        from cloak_core.core.visibility.fused import cover as fused  # needs Triton

        fused(packed, flat, row0, column0, shift)
        return
    triangles = _canonical(flat)
    rows, columns = packed.shape
    low, size = _span(triangles, shift, (column0, row0), (columns, rows))
    for own, place in _expand_boxes(low, size):
        key, inside = _packed(triangles, own, place * (1 << shift) + (1 << shift) // 2)
        column, row = place
        at = (row - row0) * columns + (column - column0)
        packed.view(-1).scatter_reduce_(0, at, torch.where(inside, key, EMPTY), "amin")


def _canonical(flat: FlatTriangles) -> Triangles:
    """Order the corners of the triangles that are not dropped."""
    corners = torch.stack([flat.x, flat.y]).to(torch.int64)[:, flat.corner]
    (d1x, d2x), (d1y, d2y) = corners[:, 1:] - corners[:, :1]
    twice = d1x * d2y - d2x * d1y
    keep = (torch.where(flat.one_sided, twice.clamp(max=0), twice) != 0).nonzero().view(-1)
    first = torch.argmin((corners[1] << 32) - corners[0], 0)
    step = torch.arange(3, device=first.device).unsqueeze(1)
    order = ((first + twice.sign() * step) % 3).index_select(1, keep)
    return Triangles(
        corners.index_select(2, keep).gather(1, order.expand(2, -1, -1)),
        flat.inverse_depth[flat.corner].index_select(1, keep).gather(0, order),
        flat.ids.index_select(0, keep),
    )


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


def _expand_boxes(
    low: Int64[Tensor, "xy=2 N"], size: Int64[Tensor, "xy=2 N"]
) -> Iterator[tuple[Int64[Tensor, " M"], Int64[Tensor, "xy=2 M"]]]:
    """List the columns and rows of boxes, each with its box's index, in chunks."""
    if not low.shape[1]:
        return
    device = low.device
    chunk = CHUNK if device.type == "cpu" else 64 * CHUNK
    counts = size.prod(0)
    ends = counts.cumsum(0)
    begin = ends - counts
    total = int(ends[-1])
    for start in range(0, total, chunk):
        number = torch.arange(start, min(start + chunk, total), device=device)
        owner = torch.searchsorted(ends, number, right=True)
        offset = number - begin.index_select(0, owner)
        across = size[0].index_select(0, owner)
        step = torch.stack([offset % across, torch.div(offset, across, rounding_mode="floor")])
        yield owner, low.index_select(1, owner) + step


def _packed(triangles: Triangles, own: Tensor, place: Int64[Tensor, "xy=2 M"]) -> tuple[Tensor, Tensor]:
    """Packed depth and id of each triangle at a sample, and whether it covers the sample, by the top-left rule.

    Edge 0-2 is on the left (or level on top) and owns its samples, edge 0-1 is on the right and does not; edge 1-2
    owns them where it is on the left.
    """
    corners = triangles.corners.index_select(2, own)
    right, below = place - corners[:, 0]
    (d1x, d2x), (d1y, d2y) = corners[:, 1:] - corners[:, :1]
    e1, e2 = d2y * right - d2x * below, d1x * below - d1y * right
    area = d1x * d2y - d1y * d2x
    y1, y2 = corners[1, 1:]
    inside = (e1 >= 0) & (e2 > 0) & (area - e1 - e2 + (y1 > y2) > 0)
    # (e1 * ((n1 - n0) / A) + e2 * ((n2 - n0) / A)) + n0, one rounding for each operation (screen.py).
    near = triangles.inverse_depth.index_select(1, own)
    inverse_depth = (torch.stack([e1, e2]).to(torch.float64) * ((near[1:] - near[0]) / area)).sum(0) + near[0]
    depth = (inverse_depth * (1 << DEPTH_BITS)).to(torch.int64).clamp(0, LIMIT)
    return torch.add(triangles.ids.index_select(0, own), LIMIT - depth, alpha=1 << ID_BITS), inside


def merge_samples(packed: Int64[Tensor, "rows columns"], grid: int, window: Window, width: int) -> Fragments:
    """Merge the visible samples of every (pixel, triangle) of one view."""
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
