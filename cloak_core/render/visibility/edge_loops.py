"""Open edges of the pieces in a cell, as loops for the CPU: those that no other piece's triangle shares on their other
side. How many pieces lie over a point changes at open edges alone, so few of them tell much about many pieces: whether
they overlap, and which hang together in a sheet."""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner
from cloak_core.render.visibility.covering_loops import doubled_area
from cloak_core.render.visibility.overlap_loops import edge_number, may_cross
from cloak_core.render.visibility.polygon_loops import TOUCH, line_through

_LINE, OWNER, _ENDS = 4, 7, 8
"""In a segment's numbers, after the two ends of what lies in the cell: its line, its piece, the corners of its edge."""
SEGMENT = 10


@inner
def find_open(triangles, chosen, found, at, table, group, segments):
    """The parts of open edges in a cell, to `segments` [3 N, SEGMENT]; returns how many.

    triangles: x, y, nearness, corner, ids and hashes of them all; chosen [found]: the triangle of each piece; at:
    column, row and size of the cell; table [K, 2]: scratch, K a power of two; group [N]: a tree of pieces that hang
    together by shared edges, see `root`.
    """
    x, y, _, corner, _, hashes = triangles
    size = 8
    while size < 6 * found:
        size *= 2
    table[:size, 1] = 0
    for i in range(found):
        group[i] = i
    for i in range(found):
        p, q, r = clockwise(x, y, corner, chosen[i])
        for k in range(3):
            if may_cross(x, y, p, q, at):
                _enter(table, size - 1, edge_number(hashes, p, q), 3 * i + k + 1, group)
            p, q, r = q, r, p
    count = 0
    for slot in range(size):
        if table[slot, 1] > 0:
            i, turns = divmod(table[slot, 1] - 1, 3)
            p, q, r = clockwise(x, y, corner, chosen[i])
            for _ in range(turns):
                p, q, r = q, r, p
            count += _segment(segments, count, x, y, p, q, at, i)
    return count


@inner
def clockwise(x, y, corner, t):
    """A triangle's corners, clockwise on the screen."""
    a, b, c = corner[0, t], corner[1, t], corner[2, t]
    return (a, b, c) if doubled_area(x, y, a, b, c) > 0 else (a, c, b)


@inner
def _enter(table, mask, number, name, group):
    """Take an edge out where its other side is in, else put it in."""
    slot = abs(number) & mask
    while table[slot, 1] != 0:
        if table[slot, 1] > 0 and table[slot, 0] == -number:
            one, other = root(group, (table[slot, 1] - 1) // 3), root(group, (name - 1) // 3)
            group[max(one, other)] = min(one, other)
            table[slot, 1] = -1
            return
        slot = (slot + 1) & mask
    table[slot, 0], table[slot, 1] = number, name


@inner
def root(group, i):
    """The piece that stands for all that hang together with piece i."""
    while group[i] != i:
        group[i] = group[group[i]]
        i = group[i]
    return i


@inner
def _segment(segments, count, x, y, p, q, at, i):
    """What of an edge lies in the cell; whether that is more than a point."""
    column, row, shift = at
    side = 1 << shift
    x0, y0 = (np.int64(x[p]) - (column << shift)) / side, (np.int64(y[p]) - (row << shift)) / side
    x1, y1 = (np.int64(x[q]) - (column << shift)) / side, (np.int64(y[q]) - (row << shift)) / side
    first, last = 0.0, 1.0
    for k in range(2):
        start, step = (x0, x1 - x0) if k == 0 else (y0, y1 - y0)
        if step != 0:
            one, other = -start / step, (1 - start) / step
            first, last = max(first, min(one, other)), min(last, max(one, other))
    own = segments[count]
    own[_LINE], own[_LINE + 1], own[_LINE + 2] = line_through(x0, y0, x1, y1)
    own[0], own[1] = x0 + first * (x1 - x0), y0 + first * (y1 - y0)
    own[2], own[3] = x0 + last * (x1 - x0), y0 + last * (y1 - y0)
    own[OWNER], own[_ENDS], own[_ENDS + 1] = i, p, q
    return (last > first) & (abs(own[2] - own[0]) + abs(own[3] - own[1]) > TOUCH)


@inner
def nothing_overlaps(x, y, corner, chosen, found, at, segments, count):
    """Whether the open edges show that no two pieces of a cell lie over each other: none cross, and nothing but its own
    piece lies at the middle of any."""
    for i in range(count):
        for j in range(i):
            if _cross(x, y, segments[i], segments[j]):
                return False
    column, row, shift = at
    side = 1 << shift
    for k in range(count):
        u, v = (segments[k, 0] + segments[k, 2]) / 2, (segments[k, 1] + segments[k, 3]) / 2
        left, top = (column << shift) + u * side, (row << shift) + v * side
        for i in range(found):
            p, q, r = corner[0, chosen[i]], corner[1, chosen[i]], corner[2, chosen[i]]
            beside = (max(x[p], x[q], x[r]) < left - 1) | (min(x[p], x[q], x[r]) > left + 1)
            beside |= (max(y[p], y[q], y[r]) < top - 1) | (min(y[p], y[q], y[r]) > top + 1)
            if beside or i == segments[k, OWNER]:
                continue
            if _depth_inside(x, y, clockwise(x, y, corner, chosen[i]), left, top) > -TOUCH * side:
                return False
    return True


@inner
def _depth_inside(x, y, corners, left, top):
    """How far inside a triangle's nearest edge a point lies, grid units; negative: outside."""
    p, q, r = corners
    depth = np.inf
    for _ in range(3):
        depth = min(depth, line_through(x[p] - left, y[p] - top, x[q] - left, y[q] - top)[2])
        p, q, r = q, r, p
    return depth


@inner
def _cross(x, y, one, other):
    """Whether two segments may cross or touch other than where edges end in one corner."""
    for i in range(_ENDS, _ENDS + 2):
        for j in range(_ENDS, _ENDS + 2):
            p, q = np.int64(one[i]), np.int64(other[j])
            if (x[p] == x[q]) & (y[p] == y[q]):
                return False
    apart = False
    for k in range(2):
        apart |= max(one[k], one[2 + k]) < min(other[k], other[2 + k]) - TOUCH
        apart |= max(other[k], other[2 + k]) < min(one[k], one[2 + k]) - TOUCH
    return not (apart or _beside(one, other) or _beside(other, one))


@inner
def _beside(one, other):
    """Whether one segment lies on one side of the other's line."""
    a, b, c = other[_LINE], other[_LINE + 1], other[_LINE + 2]
    start, end = a * one[0] + b * one[1] + c, a * one[2] + b * one[3] + c
    return (min(start, end) > TOUCH) | (max(start, end) < -TOUCH)
