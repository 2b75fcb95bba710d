"""Convex polygons, as numba loops: cut by lines (Sutherland-Hodgman), measured.

They live in the rows ("slots") of a pool [slots, SLOT]: number of corners, then x and y of each. A line is
a x + b y + c = 0, a^2 + b^2 = 1, positive inside.
"""

from __future__ import annotations

import numpy as np

from cloak_core.core.visibility.compiled import inner

CORNERS = 24
"""Capacity of a slot. Parts of triangles have four to seven corners; a pixel that needs more is sampled."""
SLOT = 1 + 2 * CORNERS
TOUCH = 1e-12
"""Pixels within which a corner counts as lying on a line: rounding stays below 1e-13."""


@inner
def cut(pool, source, a, b, c, inside, outside):
    """Cut a polygon by a line: what lies on its positive side goes to slot `inside`, the rest to slot `outside`.

    Corners on the line belong to both. A part without an inner point gets size 0. Returns False where a part would
    need more than `CORNERS`.
    """
    count, to_in, to_out, within, beyond = int(pool[source, 0]), 1, 1, False, False
    if count + 1 >= CORNERS:
        return False
    x, y = pool[source, 2 * count - 1], pool[source, 2 * count]
    along = side(x, y, a, b, c)
    for at in range(1, 2 * count + 1, 2):
        x0, y0, here = x, y, along
        x, y = pool[source, at], pool[source, at + 1]
        along = side(x, y, a, b, c)
        if here * along < 0:
            share = here / (here - along)
            u, v = x0 + share * (x - x0), y0 + share * (y - y0)
            pool[inside, to_in], pool[inside, to_in + 1] = u, v
            pool[outside, to_out], pool[outside, to_out + 1] = u, v
            to_in, to_out = to_in + 2, to_out + 2
        if along >= 0:
            pool[inside, to_in], pool[inside, to_in + 1] = x, y
            to_in, within = to_in + 2, within | (along > 0)
        if along <= 0:
            pool[outside, to_out], pool[outside, to_out + 1] = x, y
            to_out, beyond = to_out + 2, beyond | (along < 0)
    pool[inside, 0], pool[outside, 0] = to_in // 2 if within else 0, to_out // 2 if beyond else 0
    return True


@inner
def side(x, y, a, b, c):
    """Compute the distance of a point from a line, positive inside; 0 on it."""
    distance = a * x + b * y + c
    return 0.0 if abs(distance) <= TOUCH else distance


@inner
def reach(pool, slot, a, b, c):
    """Compute the greatest and least distance of a polygon's corners from a line, positive inside."""
    low, high = np.inf, -np.inf
    for at in range(1, 2 * int(pool[slot, 0]) + 1, 2):
        distance = a * pool[slot, at] + b * pool[slot, at + 1] + c
        low, high = min(low, distance), max(high, distance)
    return high, low


@inner
def copy(pool, source, slot):
    """Copy a polygon into another slot."""
    for k in range(1 + 2 * int(pool[source, 0])):
        pool[slot, k] = pool[source, k]


@inner
def measure(pool, slot):
    """Compute area and first moments (area times centroid), about the first corner so that nothing cancels."""
    x0, y0 = pool[slot, 1], pool[slot, 2]
    area = across = down = 0.0
    for k in range(3, 2 * int(pool[slot, 0]) - 1, 2):
        x1, y1 = pool[slot, k] - x0, pool[slot, k + 1] - y0
        x2, y2 = pool[slot, k + 2] - x0, pool[slot, k + 3] - y0
        twice = x1 * y2 - y1 * x2
        area += twice
        across += twice * (x1 + x2)
        down += twice * (y1 + y2)
    return area / 2, across / 6 + area / 2 * x0, down / 6 + area / 2 * y0


@inner
def line_through(x0, y0, x1, y1):
    """Compute the line through an edge, clockwise with y down; the reverse edge has the same numbers, negated."""
    dx, dy = x1 - x0, y1 - y0
    scale = 1 / np.sqrt(dx * dx + dy * dy)
    a, b = -dy * scale, dx * scale
    # From the middle, which both ways share.
    return a, b, -(a * (x0 + x1) + b * (y0 + y1)) * 0.5
