"""Convex polygons inside one pixel, as loops for the CPU: cut by lines, measured.

Polygons live in the slots of a pool, rows of `pool` [slots, SLOT]: how many corners there are, who holds the slot, the
bounding box (left, top, right, bottom), and of each corner x and y, counted from the pixel's top left corner, and the
line a x + b y + c = 0 of the edge that starts there, a^2 + b^2 = 1, positive inside. An edge keeps the line it was made
with, so that its direction stays right however short cutting leaves it. The pixel's own sides have the line (0, 0, 1):
nothing in the pixel lies beyond them.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner

CORNERS = 20
"""Room of a slot. Parts of triangles have four to seven corners; what needs more is counted (see layer_loops.py)."""
SIZE, HOLDER, BOX, FIRST, CORNER = 0, 1, 2, 6, 5
"""Where in a slot these stand; numbers for each corner."""
SLOT = FIRST + CORNER * CORNERS
TOUCH = 1e-12
"""Pixels within which a corner counts as lying on a line: rounding stays below 1e-13."""


@inner
def cut(pool, source, a, b, c, inside, outside):
    """Cut a polygon by a line: what lies on its positive side goes to slot `inside`, the rest to slot `outside`.

    Corners on the line belong to both. A part without an inner point gets size 0. Returns False where a part would
    need more than `CORNERS`.
    """
    count, ins, outs, within, beyond = int(pool[source, SIZE]), 0, 0, False, False
    if count + 1 >= CORNERS:
        return False
    at, to_in, to_out = FIRST, FIRST, FIRST
    along = _side(pool, source, at, a, b, c)
    for k in range(count):
        after = at + CORNER if k + 1 < count else FIRST
        here, along = along, _side(pool, source, after, a, b, c)
        if here >= 0:
            _corner(pool, source, at, inside, to_in, (here == 0) & (along < 0), a, b, c)
            to_in, within = to_in + CORNER, within | (here > 0)
        if here <= 0:
            _corner(pool, source, at, outside, to_out, (here == 0) & (along > 0), -a, -b, -c)
            to_out, beyond = to_out + CORNER, beyond | (here < 0)
        if here * along < 0:
            share = here / (here - along)
            x = pool[source, at] + share * (pool[source, after] - pool[source, at])
            y = pool[source, at + 1] + share * (pool[source, after + 1] - pool[source, at + 1])
            _corner(pool, source, at, inside, to_in, here > 0, a, b, c)
            _corner(pool, source, at, outside, to_out, here < 0, -a, -b, -c)
            pool[inside, to_in] = pool[outside, to_out] = x
            pool[inside, to_in + 1] = pool[outside, to_out + 1] = y
            to_in, to_out = to_in + CORNER, to_out + CORNER
        at = after
    ins, outs = (to_in - FIRST) // CORNER, (to_out - FIRST) // CORNER
    pool[inside, SIZE], pool[outside, SIZE] = ins if within else 0, outs if beyond else 0
    return True


@inner
def _side(pool, slot, at, a, b, c):
    distance = a * pool[slot, at] + b * pool[slot, at + 1] + c
    return 0.0 if abs(distance) <= TOUCH else distance


@inner
def _corner(pool, source, at, slot, to, turn, a, b, c):
    """A corner of `source` as one of `slot`, followed by its own edge, or where the cut begins by the line."""
    pool[slot, to], pool[slot, to + 1] = pool[source, at], pool[source, at + 1]
    pool[slot, to + 2] = a if turn else pool[source, at + 2]
    pool[slot, to + 3] = b if turn else pool[source, at + 3]
    pool[slot, to + 4] = c if turn else pool[source, at + 4]


@inner
def apart(pool, one, other):
    """Whether one of a polygon's edges has all of the other polygon on its outer side."""
    edges, corners = int(pool[one, SIZE]), int(pool[other, SIZE])
    for k in range(FIRST, FIRST + CORNER * edges, CORNER):
        a, b, c = pool[one, k + 2], pool[one, k + 3], pool[one, k + 4]
        reached = -1.0
        for i in range(FIRST, FIRST + CORNER * corners, CORNER):
            reached = max(reached, a * pool[other, i] + b * pool[other, i + 1] + c)
        if reached <= TOUCH:
            return True
    return False


@inner
def disjoint(pool, one, other):
    """Whether bounding boxes do no more than touch."""
    return (
        (pool[one, BOX] >= pool[other, BOX + 2] - TOUCH) | (pool[one, BOX + 2] <= pool[other, BOX] + TOUCH)
        | (pool[one, BOX + 1] >= pool[other, BOX + 3] - TOUCH) | (pool[one, BOX + 3] <= pool[other, BOX + 1] + TOUCH)
    )  # fmt: skip


@inner
def hold(pool, slot, holder):
    """Give a slot to a holder, and note its bounding box."""
    left, top, right, bottom = 2.0, 2.0, -1.0, -1.0
    for k in range(FIRST, FIRST + CORNER * int(pool[slot, SIZE]), CORNER):
        left, right = min(left, pool[slot, k]), max(right, pool[slot, k])
        top, bottom = min(top, pool[slot, k + 1]), max(bottom, pool[slot, k + 1])
    pool[slot, HOLDER] = holder
    pool[slot, BOX], pool[slot, BOX + 1], pool[slot, BOX + 2], pool[slot, BOX + 3] = left, top, right, bottom


@inner
def copy(pool, source, slot):
    """The polygon of one slot into another."""
    for k in range(FIRST + CORNER * int(pool[source, SIZE])):
        pool[slot, k] = pool[source, k]


@inner
def measure(pool, slot):
    """Area and its first moments in x and y (area times centroid), about the first corner so that nothing cancels."""
    x0, y0 = pool[slot, FIRST], pool[slot, FIRST + 1]
    area = across = down = 0.0
    for k in range(FIRST + CORNER, FIRST + CORNER * (int(pool[slot, SIZE]) - 1), CORNER):
        x1, y1 = pool[slot, k] - x0, pool[slot, k + 1] - y0
        x2, y2 = pool[slot, k + CORNER] - x0, pool[slot, k + CORNER + 1] - y0
        twice = x1 * y2 - y1 * x2
        area += twice
        across += twice * (x1 + x2)
        down += twice * (y1 + y2)
    return area / 2, across / 6 + area / 2 * x0, down / 6 + area / 2 * y0


@inner
def line_through(x0, y0, x1, y1):
    """The line of the edge from one corner to the next, clockwise on a screen with y down; the same numbers, negated,
    for the edge the other way round."""
    dx, dy = x1 - x0, y1 - y0
    scale = 1 / np.sqrt(dx * dx + dy * dy)
    a, b = -dy * scale, dx * scale
    # From the middle, which both ways share.
    return a, b, -(a * (x0 + x1) + b * (y0 + y1)) * 0.5
