"""Bounds of depth in pixels, and the nearest surface that fills each: early occlusion culling, as numba loops."""

from __future__ import annotations

import numpy as np

from cloak_core.core.visibility.compiled import inner
from cloak_core.core.visibility.cpu.edge_hash import WHOLE
from cloak_core.core.visibility.cpu.triangles import PIXEL, slopes, touched
from cloak_core.core.visibility.screen import GRID

MARGIN = 2.0**-36
"""Inverse depth by which a piece must lie behind to be dropped; depths themselves are told apart by 2^-42."""
_FAR = 1 << 30


@inner
def row_bounds(mesh, plane, row):
    """Compute the greatest and least inverse depth of a plane in a row of pixels, at the x of its first corner."""
    p0, _, down = plane
    top = mesh.inverse_depth[p0] + ((row << PIXEL) - np.int64(mesh.y[p0])) * down
    return top + max(down * GRID, 0.0), top + min(down * GRID, 0.0)


@inner
def pixel_bounds(level, plane, x, column, near, far):
    """Compute the greatest and least inverse depth that a triangle may have in a pixel."""
    high, low = level
    p0, across, _ = plane
    left = ((column << PIXEL) - np.int64(x[p0])) * across
    return min(near, high + left + max(across * GRID, 0.0)), max(far, low + left + min(across * GRID, 0.0))


@inner
def close_front(pixels):
    """Raise `front` to the pieces that fill a pixel together."""
    for at in range(len(pixels.front)):
        if (pixels.edge_sum[at] == 0) & (abs(pixels.total[at] - 1) <= WHOLE):
            pixels.front[at] = max(pixels.front[at], pixels.least[at] - MARGIN)


@inner
def fill_front(front, mesh, candidates, x0, x1, y0, y1):
    """Raise `front` to the triangles that fill pixels of the band."""
    index, areas, first, last, _ = candidates
    for k in range(len(index)):
        # What touches fewer than three rows or columns hardly ever fills a pixel by itself.
        if (last[k] - first[k] < 2) | (last[k] < y0) | (first[k] >= y1):
            continue
        t = index[k]
        a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
        left, right = touched(mesh.x[a], mesh.x[b], mesh.x[c], -_FAR, _FAR)
        if right - left < 2:
            continue
        plane = slopes(mesh.x, mesh.y, mesh.inverse_depth, a, b, c, areas[k])
        far = min(mesh.inverse_depth[a], mesh.inverse_depth[b], mesh.inverse_depth[c])
        for row in range(max(first[k], y0), min(last[k], y1 - 1) + 1):
            above, below = _span(mesh, a, b, c, row << PIXEL), _span(mesh, a, b, c, (row + 1) << PIXEL)
            # A triangle is convex: columns within it at the top and the bottom of a row are filled. 1e-6 pixels are
            # more than the rounding of both ends.
            begin = np.int64(np.ceil(max(above[0], below[0]) + 1e-6))
            end = np.int64(np.floor(min(above[1], below[1]) - 1e-6)) - 1
            if begin > end:
                continue
            level = row_bounds(mesh, plane, row)
            for column in range(max(begin, x0), min(end, x1 - 1) + 1):
                low = pixel_bounds(level, plane, mesh.x, column, 2.0, far)[1]  # 2: no depth is greater than 1
                at = (row - y0) * (x1 - x0) + column - x0
                front[at] = max(front[at], low - MARGIN)


@inner
def _span(mesh, a, b, c, level):
    """Find a triangle's extent at a level of y (grid units), from .. to in pixels; inf .. -inf where there is none."""
    x, y = mesh.x, mesh.y
    low, high = np.inf, -np.inf
    for k in range(3):
        p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        if (min(y[p], y[q]) <= level) & (max(y[p], y[q]) >= level) & (y[p] != y[q]):
            at = (x[p] + (level - np.int64(y[p])) / (np.int64(y[q]) - y[p]) * (np.int64(x[q]) - x[p])) / GRID
            low, high = min(low, at), max(high, at)
    return low, high
