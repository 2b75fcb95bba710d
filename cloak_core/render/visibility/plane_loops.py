"""Pieces of triangles in a cell as convex polygons and as planes of depth, as loops for the CPU."""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner
from cloak_core.render.covering_loops import doubled_area, in_order
from cloak_core.render.visibility.overlap_loops import within
from cloak_core.render.visibility.polygon_loops import CORNER, FIRST, SIZE, copy, cut, line_through

DEPTH_STEPS = 2.0**42
"""Steps of nearness that are told apart."""
GREATEST, LEAST, ID, AREA, NUMBERS = 3, 4, 5, 6, 9
"""In a piece's numbers, after its plane: bounds of its depth, its triangle's id, the share that is seen, and where."""


@inner
def plane(x, y, nearness, corner, ids, t, at, pieces, i):
    """A triangle in a cell: nearness at its corner and changes over the cell; the greatest and least it may have."""
    a, b, c = corner[0, t], corner[1, t], corner[2, t]
    twice = doubled_area(x, y, a, b, c)
    p0, p1, p2 = in_order(x, y, a, b, c, twice)
    x0, y0 = np.int64(x[p0]), np.int64(y[p0])
    d1x, d1y, d2x, d2y = x[p1] - x0, y[p1] - y0, x[p2] - x0, y[p2] - y0
    column, row, shift = at
    side = 1 << shift
    right, below = (column << shift) - x0, (row << shift) - y0
    e1, e2 = d2y * right - d2x * below, d1x * below - d1y * right
    n0, n1, n2 = nearness[p0], nearness[p1], nearness[p2]
    size = float(abs(twice))
    slope1, slope2 = (n1 - n0) / size, (n2 - n0) / size
    begin = _steps(e1, e2, slope1, slope2, n0)
    across = _steps(e1 + d2y * side, e2 - d1y * side, slope1, slope2, n0) - begin
    down = _steps(e1 - d2x * side, e2 + d1x * side, slope1, slope2, n0) - begin
    pieces[i, 0], pieces[i, 1], pieces[i, 2] = begin, across, down
    most, least = np.ceil(max(n0, n1, n2) * DEPTH_STEPS) + 1, np.floor(min(n0, n1, n2) * DEPTH_STEPS) - 1
    pieces[i, GREATEST] = min(begin + max(across, 0.0) + max(down, 0.0), most)
    pieces[i, LEAST] = max(begin + min(across, 0.0) + min(down, 0.0), least)
    pieces[i, ID] = ids[t]


@inner
def _steps(e1, e2, slope1, slope2, n0):
    return np.rint(((float(e1) * slope1 + float(e2) * slope2) + n0) * DEPTH_STEPS)


@inner
def polygon(pool, slot, x, y, a, b, c, at):
    """A triangle cut to a cell, counted from the cell's corner, into a slot."""
    column, row, shift = at
    ax, ay = _from(x[a], column, shift), _from(y[a], row, shift)
    bx, by = _from(x[b], column, shift), _from(y[b], row, shift)
    cx, cy = _from(x[c], column, shift), _from(y[c], row, shift)
    if (bx - ax) * (cy - ay) - (cx - ax) * (by - ay) < 0:
        bx, by, cx, cy = cx, cy, bx, by
    _set_corner(pool, slot, FIRST, ax, ay, bx, by)
    _set_corner(pool, slot, FIRST + CORNER, bx, by, cx, cy)
    _set_corner(pool, slot, FIRST + 2 * CORNER, cx, cy, ax, ay)
    pool[slot, SIZE] = 3
    inside_x, inside_y = within(x[a], x[b], x[c], column, shift), within(y[a], y[b], y[c], row, shift)
    for k in range(4):
        if not (inside_x if k < 2 else inside_y):
            sign = 1.0 if k % 2 == 0 else -1.0
            _cut_side(pool, slot, sign if k < 2 else 0.0, sign if k >= 2 else 0.0, 0.0 if k % 2 == 0 else 1.0)


@inner
def _from(position, cell, shift):
    return (np.int64(position) - (cell << shift)) / (1 << shift)


@inner
def _set_corner(pool, slot, at, x0, y0, x1, y1):
    pool[slot, at], pool[slot, at + 1] = x0, y0
    pool[slot, at + 2], pool[slot, at + 3], pool[slot, at + 4] = line_through(x0, y0, x1, y1)


@inner
def _cut_side(pool, slot, a, b, c):
    """Cut a slot by a side of the pixel; edges along it become the pixel's own."""
    beyond = False
    for k in range(FIRST, FIRST + CORNER * int(pool[slot, SIZE]), CORNER):
        beyond |= a * pool[slot, k] + b * pool[slot, k + 1] + c < 0
    if not beyond:
        return
    cut(pool, slot, a, b, c, 0, 1)
    copy(pool, 0, slot)
    for k in range(FIRST, FIRST + CORNER * int(pool[slot, SIZE]), CORNER):
        if pool[slot, k + 2] == a and pool[slot, k + 3] == b and pool[slot, k + 4] == c:
            pool[slot, k + 2], pool[slot, k + 3], pool[slot, k + 4] = 0.0, 0.0, 1.0
