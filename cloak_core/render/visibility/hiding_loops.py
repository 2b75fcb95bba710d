"""What is seen in a cell, as loops for the CPU: from each piece is cut away what nearer ones hide of it.

As areas.py does it: the part of a piece inside another triangle, where that one is nearer, is convex, so that what
stays is a list of convex parts. Triangles that pierce each other are cut along their line. A cell is a pixel, or a part
of one: column, row, and its size as a shift; places are counted from its corner, in its sides.

Depth is a plane for each piece, three whole numbers: nearness at the cell's corner times 2^42, and what it changes by
over the cell right and down. Differences of whole numbers do not round, so of any three triangles the order is
without contradiction; equal ones go to the lower id.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner
from cloak_core.render.visibility.covering_loops import doubled_area, in_order
from cloak_core.render.visibility.edge_loops import find_open, root
from cloak_core.render.visibility.polygon_loops import TOUCH, copy, cut, line_through, measure, reach

DEPTH_STEPS = 2.0**42
"""Steps of nearness that are told apart."""
_GREATEST, _LEAST, _ID, _BOX, _CORNERS, _LINES = 3, 4, 5, 6, 10, 16
"""In a piece's numbers, after its plane: bounds of its depth, its triangle's id, its box (left, top, right, bottom), x
and y of its triangle's corners, clockwise on the screen, and the lines of its edges."""
NUMBERS = 25
_FIELDS = 8
"""Boxes are compared by the fields of an 8 x 8 grid that they touch, bits of a number, before they are themselves."""
_PARTS = 2
"""The first slot of the pool that holds parts of a piece; those before it are scratch."""
_NOTHING = 1e-15
_BEHIND, _NEARER, _PARTLY = 0, 1, 2


@inner
def settle_cell(triangles, at, chosen, found, pieces, masks, pool, seen, room, count):
    """What is seen in a cell of each piece: area (of cells) and its moments to `seen`, -1 where nothing is hidden.

    triangles: x, y, nearness, corner and ids of them all; chosen [found]: the triangle of each piece; pieces, masks,
    pool: scratch; room: see `sheet_loops.edge_room`; count: of the cell's open edges if they are in there, or -1.
    Returns whether there was room; where not, too little may have been cut away.
    """
    x, y, nearness, corner, ids, _ = triangles
    group, segments, opened, enough = room[1], room[2], np.int64(0), True
    if count < 0:
        count = find_open(triangles, chosen, found, at, room[0], group, segments)
    for k in range(count):
        u, v = (segments[k, 0], segments[k, 2]), (segments[k, 1], segments[k, 3])
        opened |= _mask(min(u), min(v), max(u), max(v))
    for i in range(found):
        group[i] = root(group, i)
        masks[0, i] = _describe(x, y, nearness, corner, ids, chosen[i], at, pieces, i)
    for i in range(found):
        end = 0
        held = 0
        for q in range(found):
            masks[1, held] = q  # without a branch: which way it goes, nothing could foresee
            held += _may_hide(pieces, masks, i, q)
        for k in range(held):
            q = masks[1, k]
            if q == i or _beside(pieces, i, q):
                continue
            depth = _depth(pieces, i, q)
            if depth == _BEHIND:
                continue
            if end == 0:
                end = _PARTS + _polygon(pool, _PARTS, pieces, i)
                if end == _PARTS or (not opened & masks[0, i] and _is_hidden(pool, pieces, masks, group, i, found)):
                    end = _PARTS
                    break
            end, fits = _take_away(pool, pieces, i, q, depth, end)
            enough &= fits
            if end == _PARTS:
                break
        seen[i, 0] = -1.0 if end == 0 else 0.0
        seen[i, 1] = seen[i, 2] = 0.0
        for slot in range(_PARTS, end):
            _add(pool, slot, seen, i)
    return enough


@inner
def _is_hidden(pool, pieces, masks, group, i, found):
    """Whether a piece that no open edge crosses lies behind a whole sheet: one that its middle lies in, and that is
    nearer wherever both may be."""
    x = y = 0.0
    size = int(pool[_PARTS, 0])
    for at in range(1, 2 * size + 1, 2):
        x, y = x + pool[_PARTS, at] / size, y + pool[_PARTS, at + 1] / size
    for q in range(found):
        if not masks[0, q] & masks[0, i] or group[q] == group[i] or not _holds(pieces, q, x, y):
            continue
        hidden = _depth(pieces, i, q) == _NEARER
        for r in range(found):
            if hidden and group[r] == group[q] and masks[0, r] & masks[0, i]:
                hidden = _depth(pieces, i, r) == _NEARER or _beside(pieces, i, r) or _beside(pieces, r, i)
        if hidden:
            return True
    return False


@inner
def _holds(pieces, q, x, y):
    """Whether a point lies well inside a triangle."""
    for line in range(_LINES, _LINES + 9, 3):
        if pieces[q, line] * x + pieces[q, line + 1] * y + pieces[q, line + 2] <= TOUCH:
            return False
    return True


@inner
def whole_piece(pool, pieces, seen, i):
    """Area and moments of all of a piece within its cell."""
    seen[i, 0] = 0.0
    if _polygon(pool, _PARTS, pieces, i):
        _add(pool, _PARTS, seen, i)


@inner
def _add(pool, slot, seen, i):
    area, across, down = measure(pool, slot)
    seen[i, 0] += area
    seen[i, 1] += across
    seen[i, 2] += down


@inner
def _describe(x, y, nearness, corner, ids, t, at, pieces, i):
    """A piece's numbers; returns the fields that its box touches, as bits."""
    a, b, c = corner[0, t], corner[1, t], corner[2, t]
    twice = doubled_area(x, y, a, b, c)
    p0, p1, p2 = in_order(x, y, a, b, c, twice)
    column, row, shift = at
    side = 1 << shift
    x0, y0 = np.int64(x[p0]) - (column << shift), np.int64(y[p0]) - (row << shift)
    d1x, d1y, d2x, d2y = (
        x[p1] - np.int64(x[p0]),
        y[p1] - np.int64(y[p0]),
        x[p2] - np.int64(x[p0]),
        y[p2] - np.int64(y[p0]),
    )
    e1, e2 = d2x * y0 - d2y * x0, d1y * x0 - d1x * y0
    n0, n1, n2 = nearness[p0], nearness[p1], nearness[p2]
    size = float(abs(twice))
    slope1, slope2 = (n1 - n0) / size, (n2 - n0) / size
    begin = _steps(e1, e2, slope1, slope2, n0)
    across = _steps(e1 + d2y * side, e2 - d1y * side, slope1, slope2, n0) - begin
    down = _steps(e1 - d2x * side, e2 + d1x * side, slope1, slope2, n0) - begin
    pieces[i, 0], pieces[i, 1], pieces[i, 2] = begin, across, down
    most, least = np.ceil(max(n0, n1, n2) * DEPTH_STEPS) + 1, np.floor(min(n0, n1, n2) * DEPTH_STEPS) - 1
    pieces[i, _GREATEST] = min(begin + max(across, 0.0) + max(down, 0.0), most)
    pieces[i, _LEAST] = max(begin + min(across, 0.0) + min(down, 0.0), least)
    pieces[i, _ID] = ids[t]
    unit = 1.0 / side
    x0, y0, x1, y1, x2, y2 = (
        x0 * unit,
        y0 * unit,
        (x0 + d1x) * unit,
        (y0 + d1y) * unit,
        (x0 + d2x) * unit,
        (y0 + d2y) * unit,
    )
    pieces[i, _BOX], pieces[i, _BOX + 1] = max(min(x0, x1, x2), 0.0), max(min(y0, y1, y2), 0.0)
    pieces[i, _BOX + 2], pieces[i, _BOX + 3] = min(max(x0, x1, x2), 1.0), min(max(y0, y1, y2), 1.0)
    _set_corner(pieces, i, 0, x0, y0, x1, y1)
    _set_corner(pieces, i, 1, x1, y1, x2, y2)
    _set_corner(pieces, i, 2, x2, y2, x0, y0)
    return _mask(pieces[i, _BOX], pieces[i, _BOX + 1], pieces[i, _BOX + 2], pieces[i, _BOX + 3])


@inner
def _steps(e1, e2, slope1, slope2, n0):
    return np.rint(((float(e1) * slope1 + float(e2) * slope2) + n0) * DEPTH_STEPS)


@inner
def _set_corner(pieces, i, k, x0, y0, x1, y1):
    """Corner k and the line of the edge from there to the next."""
    pieces[i, _CORNERS + 2 * k], pieces[i, _CORNERS + 2 * k + 1] = x0, y0
    line = _LINES + 3 * k
    pieces[i, line], pieces[i, line + 1], pieces[i, line + 2] = line_through(x0, y0, x1, y1)


@inner
def _mask(left, top, right, bottom):
    """The fields that a box touches, as bits."""
    u0, u1 = np.int64(left * _FIELDS), min(np.int64(right * _FIELDS), _FIELDS - 1)
    v0, v1 = np.int64(top * _FIELDS), min(np.int64(bottom * _FIELDS), _FIELDS - 1)
    row, bits = (np.int64(2) << u1) - (np.int64(1) << u0), np.int64(0)
    for v in range(v0, v1 + 1):
        bits |= row << (v * _FIELDS)
    return bits


@inner
def _may_hide(pieces, masks, i, q):
    """Whether boxes meet and piece q is not behind piece i there."""
    left, right = max(pieces[i, _BOX], pieces[q, _BOX]), min(pieces[i, _BOX + 2], pieces[q, _BOX + 2])
    top, bottom = max(pieces[i, _BOX + 1], pieces[q, _BOX + 1]), min(pieces[i, _BOX + 3], pieces[q, _BOX + 3])
    c, a, b = pieces[q, 0] - pieces[i, 0], pieces[q, 1] - pieces[i, 1], pieces[q, 2] - pieces[i, 2]
    ahead = c + max(a * left, a * right) + max(b * top, b * bottom)
    meet = (left < right - TOUCH) & (top < bottom - TOUCH) & ((masks[0, q] & masks[0, i]) != 0)
    return meet & (ahead >= 0) & (pieces[q, _GREATEST] >= pieces[i, _LEAST])


@inner
def _depth(pieces, i, q):
    """Whether piece q is nearer than piece i wherever boxes meet, or in a part of that, or nowhere."""
    left, right = max(pieces[i, _BOX], pieces[q, _BOX]), min(pieces[i, _BOX + 2], pieces[q, _BOX + 2])
    top, bottom = max(pieces[i, _BOX + 1], pieces[q, _BOX + 1]), min(pieces[i, _BOX + 3], pieces[q, _BOX + 3])
    c, a, b = pieces[q, 0] - pieces[i, 0], pieces[q, 1] - pieces[i, 1], pieces[q, 2] - pieces[i, 2]
    if (a == 0) & (b == 0) & (c == 0):
        return _NEARER if pieces[q, _ID] < pieces[i, _ID] else _BEHIND
    if c + max(a * left, a * right) + max(b * top, b * bottom) <= 0:
        return _BEHIND
    return _NEARER if c + min(a * left, a * right) + min(b * top, b * bottom) >= 0 else _PARTLY


@inner
def _beside(pieces, i, q):
    """Whether one of triangle i's edges has all of triangle q on its outer side, or boxes do no more than touch."""
    left, right = max(pieces[i, _BOX], pieces[q, _BOX]), min(pieces[i, _BOX + 2], pieces[q, _BOX + 2])
    top, bottom = max(pieces[i, _BOX + 1], pieces[q, _BOX + 1]), min(pieces[i, _BOX + 3], pieces[q, _BOX + 3])
    if (left >= right - TOUCH) | (top >= bottom - TOUCH):
        return True
    for line in range(_LINES, _LINES + 9, 3):
        a, b, c, high = pieces[i, line], pieces[i, line + 1], pieces[i, line + 2], -1.0
        for k in range(_CORNERS, _CORNERS + 6, 2):
            high = max(high, a * pieces[q, k] + b * pieces[q, k + 1] + c)
        if high <= TOUCH:
            return True
    return False


@inner
def _take_away(pool, pieces, i, q, depth, end):
    """Cut away from the parts of piece i what piece q hides; returns where the parts end, and whether there was room
    for all of them."""
    a, b, c = pieces[q, 1] - pieces[i, 1], pieces[q, 2] - pieces[i, 2], pieces[q, 0] - pieces[i, 0]
    scale = 1 / np.sqrt(a * a + b * b) if depth == _PARTLY else 0.0
    nearer = a * scale, b * scale, c * scale
    for slot in range(end - 1, _PARTS - 1, -1):
        before = end
        crossed, missed = _crossed(pool, slot, pieces, q, depth, nearer)
        if missed:
            continue
        source, into = slot, 0
        for k in range(4):
            if not crossed & (1 << k):
                continue
            u, v, w = _line(pieces, q, k, nearer)
            if end >= len(pool) or not cut(pool, source, u, v, w, into, end):
                return before, False
            end += (pool[end, 0] >= 3) and (measure(pool, end)[0] > _NOTHING)
            if pool[into, 0] < 3:
                break
            source, into = into, 1 - into
        end -= 1
        if slot < end:
            copy(pool, end, slot)
    return end, True


@inner
def _line(pieces, q, k, nearer):
    """An edge of a piece's triangle, or after these the line where it is as near as another."""
    if k == 3:
        return nearer
    line = _LINES + 3 * k
    return pieces[q, line], pieces[q, line + 1], pieces[q, line + 2]


@inner
def _crossed(pool, slot, pieces, q, depth, nearer):
    """Which of the lines about what a piece hides cross a part, as bits; and whether it lies beyond any of them."""
    crossed = 0
    for k in range(4 if depth == _PARTLY else 3):
        a, b, c = _line(pieces, q, k, nearer)
        inside, outside = reach(pool, slot, a, b, c)
        if inside <= TOUCH:
            return 0, True
        crossed |= (outside < -TOUCH) << k
    return crossed, False


@inner
def _polygon(pool, slot, pieces, i):
    """A piece, its triangle cut to the cell, into a slot; whether there is anything."""
    pool[slot, 0] = 3
    for k in range(6):
        pool[slot, 1 + k] = pieces[i, _CORNERS + k]
    for k in range(4):
        sign = 1.0 if k % 2 == 0 else -1.0
        a, b, c = sign if k < 2 else 0.0, sign if k >= 2 else 0.0, 0.0 if k % 2 == 0 else 1.0
        if reach(pool, slot, a, b, c)[1] < 0:
            cut(pool, slot, a, b, c, 0, 1)
            copy(pool, 0, slot)
    return pool[slot, 0] >= 3
