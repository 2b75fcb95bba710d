"""Area and first moments of a triangle in each pixel: signed-area accumulation, as in font rasterizers, in numba loops.

What lies to the right of each edge, with the edge's sign, is summed up along each row of pixels. Edges are walked from
the top down, whichever way a triangle lists them, so that two triangles that share one split a pixel without gap or
overlap.
"""

from __future__ import annotations

import numpy as np

from cloak_core.core.visibility.compiled import inner
from cloak_core.core.visibility.cpu.edge_hash import edge_hash
from cloak_core.core.visibility.screen import GRID


@inner
def prepare_edges(edges, signs, mesh, corners, twice):
    """Write a triangle's edges, each from its upper end (of two the left one), and their hashes.

    edges [3, 6]: x, y, x, y in pixels, change of x with y, and 1 where the triangle lies on its right, -1 on its left.
    """
    a, b, c = corners
    x, y = mesh.x, mesh.y
    for k in range(3):
        p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        if twice > 0:
            p, q = q, p
        # Now the triangle is counter-clockwise on the screen: it lies to the right of what goes down.
        signs[k] = edge_hash(mesh.hashes, p, q)
        down = (y[p] < y[q]) | ((y[p] == y[q]) & (x[p] < x[q]))
        u, v = (p, q) if down else (q, p)
        edges[k, 0], edges[k, 1] = x[u] / GRID, y[u] / GRID
        edges[k, 2], edges[k, 3] = x[v] / GRID, y[v] / GRID
        height = edges[k, 3] - edges[k, 1]
        edges[k, 4] = (edges[k, 2] - edges[k, 0]) / height if height > 0 else 0.0
        edges[k, 5] = 1.0 if down else -1.0


@inner
def walk_row(edges, signs, sums, edge_sum, row, x0, x1, base):
    """Accumulate the edges in a row of pixels into `sums` [width + 1, 5].

    sums: area and moments right of the edges within the pixel, area and moment in y for every pixel to the right.
    Returns the first and last column that they touch, and area and moment that come in from the left.
    """
    begin, end, carry, moment = np.int64(x1), np.int64(x0), 0.0, 0.0
    for k in range(3):
        if (edges[k, 3] <= row) | (edges[k, 1] >= row + 1):
            continue
        u0, v0, u1, v1 = _clip_to_row(edges, k, row)
        side = edges[k, 5]
        column, stop = np.int64(np.floor(u0)), np.int64(np.ceil(u1)) - 1
        slant = (v1 - v0) / (u1 - u0) if u1 > u0 else 0.0
        if column < x0:
            beyond = v1 if u1 <= x0 else v0 + (x0 - u0) * slant
            part = side * abs(beyond - v0)
            carry, moment = carry + part, moment + part * (v0 + beyond) / 2
            if u1 <= x0:
                begin = np.int64(x0)
                continue
            u0, v0, column = float(x0), beyond, np.int64(x0)
        begin, end = min(begin, column), max(end, min(max(stop, column), x1 - 1))
        while column < x1:
            u, v = (u1, v1) if column >= stop else (column + 1.0, v0 + (column + 1 - u0) * slant)
            _add_edge(sums, column - x0, u0 - column, v0, u - column, v, side)
            if (u0 > column) | (u > column):
                edge_sum[base + column - x0] += signs[k]
            if column >= stop:
                break
            u0, v0, column = u, v, column + 1
    return begin, end, carry, moment


@inner
def _clip_to_row(edges, k, row):
    """Clip an edge to a row of pixels, from left to right; y counted from the row."""
    xt, yt, xb, yb, slope = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3], edges[k, 4]
    v0, v1, u0, u1 = yt - row, yb - row, xt, xb
    low, high = min(xt, xb), max(xt, xb)
    if v0 < 0:
        v0, u0 = 0.0, min(max(xt + (row - yt) * slope, low), high)
    if v1 > 1:
        v1, u1 = 1.0, min(max(xt + (row + 1 - yt) * slope, low), high)
    return (u0, v0, u1, v1) if u1 >= u0 else (u1, v1, u0, v0)


@inner
def _add_edge(sums, at, u0, v0, u1, v1, side):
    """Add a part of an edge within one pixel."""
    part, middle = side * abs(v1 - v0), (v0 + v1) / 2
    sums[at, 0] += part * (1 - (u0 + u1) / 2)
    sums[at, 1] += part * (1 - (u0 * u0 + u0 * u1 + u1 * u1) / 3) / 2
    sums[at, 2] += part * (middle - (2 * u0 * v0 + u0 * v1 + u1 * v0 + 2 * u1 * v1) / 6)
    sums[at, 3] += part
    sums[at, 4] += part * middle
