"""Triangles on the snapped screen, as numba loops: area, canonical order of corners, plane of inverse depth."""

from __future__ import annotations

import numpy as np

from cloak_core.core.visibility.compiled import inner, loop
from cloak_core.core.visibility.screen import GRID

PIXEL = GRID.bit_length() - 1
"""There are 2^PIXEL grid units in a pixel."""


@loop
def doubled_area(x, y, a, b, c):
    """Compute twice the signed area of a triangle, positive where clockwise on a screen with y down."""
    ax, ay = np.int64(x[a]), np.int64(y[a])
    return (x[b] - ax) * (y[c] - ay) - (x[c] - ax) * (y[b] - ay)


@loop
def in_order(x, y, a, b, c, twice):
    """Order a triangle's corners: the topmost one (of two the right one) first, clockwise from there.

    Branch-free: the branch is unpredictable.
    """
    b, c = (c, b) if twice < 0 else (b, c)
    # One number that is least where a corner is topmost, then rightmost.
    at_a, at_b, at_c = _height(x, y, a), _height(x, y, b), _height(x, y, c)
    first_b, first_c = (at_b < at_a) & (at_b < at_c), (at_c < at_a) & (at_c < at_b)
    p0 = b if first_b else (c if first_c else a)
    p1 = c if first_b else (a if first_c else b)
    p2 = a if first_b else (b if first_c else c)
    return p0, p1, p2


@loop
def _height(x, y, a):
    return (np.int64(y[a]) << 32) - x[a]


@inner
def slopes(x, y, inverse_depth, a, b, c, twice):
    """Compute the plane of inverse depth: first corner in canonical order, change per grid unit right and down."""
    p0, p1, p2 = in_order(x, y, a, b, c, twice)
    size = float(abs(twice))
    slope1, slope2 = (inverse_depth[p1] - inverse_depth[p0]) / size, (inverse_depth[p2] - inverse_depth[p0]) / size
    d1x, d1y = np.int64(x[p1]) - x[p0], np.int64(y[p1]) - y[p0]
    d2x, d2y = np.int64(x[p2]) - x[p0], np.int64(y[p2]) - y[p0]
    return p0, d2y * slope1 - d1y * slope2, d1x * slope2 - d2x * slope1


@inner
def touched(a, b, c, start, stop):
    """Find the first and last pixel, from start to stop - 1, that a triangle touches along one axis."""
    low, high = np.int64(min(a, b, c)) >> PIXEL, (np.int64(max(a, b, c)) - 1) >> PIXEL
    return max(low, start), min(high, stop - 1)
