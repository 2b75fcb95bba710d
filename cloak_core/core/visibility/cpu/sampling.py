"""The nearest triangle at every sample, and samples merged to fragments, as numba loops.

Edge functions are evaluated in int64 throughout: within the guard band nothing overflows.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from cloak_core.core.view import FlatTriangles, Fragments, Window
from cloak_core.core.visibility.compiled import arrays, loop
from cloak_core.core.visibility.cpu.triangles import doubled_area, in_order
from cloak_core.core.visibility.screen import DEPTH_BITS, EMPTY, GRID, ID_BITS, LIMIT

SIDE = 64
"""Samples along each side of a pixel of too many pieces to resolve exactly."""
_SHIFT = (GRID // SIDE).bit_length() - 1
_SCALE = float(1 << DEPTH_BITS)
_ID = (1 << ID_BITS) - 1
_SHORT = 4
"""The samples of rows up to this length are tested one by one; beyond, a division for each edge is quicker."""


def cover(packed: Int64[Tensor, "rows columns"], flat: FlatTriangles, row0: int, column0: int, shift: int) -> None:
    """See `torch/sampling.py`."""
    _draw(packed.numpy(), *flat.arrays(), row0, column0, shift)


@loop
def _draw(packed, x, y, inverse_depth, corner, ids, one_sided, row0, column0, shift):
    """Draw every triangle of one view into `packed` [rows, columns], the samples from row0 and column0 on.

    x, y: snapped, int32 [K]; inverse_depth: float64 [K]; corner: int64 [3, N]; ids: int64 [N]; one_sided: bool [N],
    whether they are dropped where they show their back, that is, are clockwise; shift: there are 2^shift grid units
    between samples.
    """
    rows, columns = packed.shape
    last_row, last_column = row0 + rows - 1, column0 + columns - 1
    for t in range(corner.shape[1]):
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        c0, c1 = _span(x[a], x[b], x[c], shift, column0, last_column)
        if c0 > c1:
            continue
        r0, r1 = _span(y[a], y[b], y[c], shift, row0, last_row)
        if r0 > r1:
            continue
        twice = doubled_area(x, y, a, b, c)
        if twice == 0 or (one_sided[t] and twice > 0):
            continue
        corners = in_order(x, y, a, b, c, twice)
        _cover_box(packed, x, y, inverse_depth, corners, ids[t], r0, r1, c0, c1, row0, column0, shift)


@loop
def _span(a, b, c, shift, first, last):
    """Find the first and last sample within a triangle's extent along one axis."""
    half = (1 << shift) >> 1
    low = (np.int64(min(a, b, c)) + half - 1) >> shift  # ceil((low - half) / step)
    high = (np.int64(max(a, b, c)) - half) >> shift
    return max(low, first), min(high, last)


@loop
def _cover_box(packed, x, y, inverse_depth, corners, name, r0, r1, c0, c1, row0, column0, shift):
    """Test one triangle at the samples of its box. name: its id."""
    p0, p1, p2 = corners
    x0, y0 = np.int64(x[p0]), np.int64(y[p0])
    step = 1 << shift
    half = step >> 1
    d1x, d1y, d2x, d2y = x[p1] - x0, y[p1] - y0, x[p2] - x0, y[p2] - y0
    area = d1x * d2y - d1y * d2x
    n0 = inverse_depth[p0]
    size = float(area)
    slope1, slope2 = (inverse_depth[p1] - n0) / size, (inverse_depth[p2] - n0) / size
    across0, across1, across2 = (d1y - d2y) * step, d2y * step, -d1y * step
    right, width = c0 * step + half - x0, c1 - c0 + 1
    for row in range(r0, r1 + 1):
        below = row * step + half - y0
        e1, e2 = d2y * right - d2x * below, d1x * below - d1y * right
        e0 = area - e1 - e2
        low = 0
        high = width
        if width > _SHORT:
            low, high = _run(e0, e1, e2, across0, across1, across2, width)
        for k in range(low, high):
            here1, here2 = e1 + k * across1, e2 + k * across2
            near = float(here1) * slope1 + float(here2) * slope2 + n0
            depth = min(max(np.int64(near * _SCALE), 0), LIMIT)
            key = ((LIMIT - depth) << ID_BITS) | name
            # Branch-free: the branch is unpredictable. In a run all samples are inside.
            inside = _inside(e0 + k * across0, here1, here2, across0)
            at = row - row0, c0 + k - column0
            packed[at] = min(packed[at], key if inside else EMPTY)


@loop
def _run(e0, e1, e2, across0, across1, across2, width):
    """The run [low, high) of a row's columns that are inside, by the top-left rule: edges 0-2, and 1-2 where it is on
    the left, own their samples; the others do not."""
    low = 0
    high = min(width, _quotient_up(e2, -across2))
    if across1 > 0:  # else level on top, and no row of the box lies above it
        low = max(low, _quotient_up(-e1, across1))
    if across0 > 0:
        low = max(low, _quotient_up(-e0, across0))
    elif across0 < 0:
        high = min(high, _quotient_up(e0, -across0))
    elif e0 <= 0:
        high = 0
    return low, high


@loop
def _inside(e0, e1, e2, across0):
    return (e1 >= 0) & (e2 > 0) & ((e0 > 0) | ((e0 == 0) & (across0 > 0)))


@loop
def _quotient_up(value, divisor):
    """value / divisor, rounded up; divisor > 0."""
    return -((-value) // divisor)


def merge_samples(packed: Tensor, grid: int, window: Window, width: int) -> Fragments:
    """See `torch/sampling.py`."""
    fragments = _merge(*arrays(packed), grid, window.y0 * grid, window.x0 * grid, width)
    return Fragments(*map(torch.from_numpy, fragments))


@loop
def _merge(packed, grid, row0, column0, width):
    """Merge each pixel's visible samples by triangle, ascending: pixel, triangle, area, mean x and y.

    packed: [rows, columns], grid x grid samples to a pixel, from the sample at row0 and column0 of the image on.
    """
    most = count = 0
    for key in packed.flat:
        most += key != EMPTY
    pixel, triangle, area = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.float32)
    x, y = np.empty(most), np.empty(most)
    names, sums = np.empty(grid * grid, np.int64), np.empty((3, grid * grid), np.int64)
    for top in range(0, packed.shape[0], grid):
        for left in range(0, packed.shape[1], grid):
            present = _gather(packed, top, left, grid, names, sums)
            place = (row0 + top) // grid * width + (column0 + left) // grid
            for i in range(present):
                held = sums[0, i]
                x[count] = (column0 + left + 0.5 + sums[1, i] / held) / grid
                y[count] = (row0 + top + 0.5 + sums[2, i] / held) / grid
                area[count] = held / (grid * grid)
                pixel[count] = place
                triangle[count] = names[i]
                count += 1
    return pixel[:count], triangle[:count], area[:count], x[:count], y[:count]


@loop
def _gather(packed, top, left, grid, names, sums):
    """List a pixel's triangles, ascending, with the number and the sums of columns and rows of their samples."""
    count = 0
    for row in range(grid):
        for column in range(grid):
            key = packed[top + row, left + column]
            if key == EMPTY:
                continue
            at = count - 1  # the latest is the likeliest
            while at >= 0 and names[at] != key & _ID:
                at -= 1
            if at < 0:
                at = count
                while at > 0 and names[at - 1] > key & _ID:
                    names[at] = names[at - 1]
                    sums[0, at] = sums[0, at - 1]
                    sums[1, at], sums[2, at] = sums[1, at - 1], sums[2, at - 1]
                    at -= 1
                names[at] = key & _ID
                sums[0, at] = sums[1, at] = sums[2, at] = 0
                count += 1
            sums[0, at] += 1
            sums[1, at] += column
            sums[2, at] += row
    return count


@loop
def sample_pixel(mesh, column, row, owner, coverage):
    """Sample the pieces of one pixel: area and centroid of each visible one into `coverage` [3, n], 0 for the others.

    owner [n]: their triangles.
    """
    # Names ascend with triangle ids, so that equal depths go to the lower id.
    order = np.argsort(mesh.ids[owner])
    packed = np.full((SIDE, SIDE), EMPTY)
    corner = mesh.corner[:, owner[order]]
    names = np.arange(len(order))
    one_sided = np.zeros(len(order), np.bool_)
    _draw(packed, mesh.x, mesh.y, mesh.inverse_depth, corner, names, one_sided, row * SIDE, column * SIDE, _SHIFT)
    coverage[:] = 0
    for y in range(SIDE):
        for x in range(SIDE):
            if packed[y, x] != EMPTY:
                piece = order[packed[y, x] & _ID]
                coverage[0, piece] += 1
                coverage[1, piece] += x
                coverage[2, piece] += y
    for piece in range(len(owner)):
        held = float(coverage[0, piece])
        if held > 0:
            coverage[1, piece] = (coverage[1, piece] / held + 0.5) / SIDE
            coverage[2, piece] = (coverage[2, piece] / held + 0.5) / SIDE
        coverage[0, piece] = held / (SIDE * SIDE)
