"""What is in front within one pixel, as loops for the CPU: pieces of triangles cut against each other, no samples.

A map of what is seen is kept, convex parts that do not overlap. Pieces enter it from front to back; each is cut against
every part that it meets: where the part is nearer the piece goes, where the piece is nearer the part goes, and planes
that pierce each other are cut along their line. So the parts always cover just the union of what came in, whatever
their depths say. Once they fill the pixel, what lies behind all of them needs no look.

Depth is a plane for each triangle, three whole numbers: nearness at the pixel's corner times 2^42, and what it changes
by over a pixel right and down. Differences of whole numbers do not round, so of any three triangles the order is
without contradiction; equal ones go to the lower id.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner, loop
from cloak_core.render.covering_loops import in_order
from cloak_core.render.visibility.overlap_loops import NOTHING, PIXEL, edges_in, within
from cloak_core.render.visibility.polygon_loops import (
    CORNER,
    FIRST,
    HOLDER,
    SIZE,
    SLOT,
    apart,
    copy,
    cut,
    disjoint,
    hold,
    line_through,
    measure,
)  # fmt: skip

MOST_PARTS = 4096
"""Parts in the map of one pixel beyond which it is given up: it keeps what it has, and is counted."""
WHOLE = 1e-6
"""Shares that add up to 1 within this fill the pixel once where every edge is closed: else they add up to 0 or 2."""
_FULL = 1e-11
DEPTH_STEPS = 2.0**42
"""Steps of nearness that are told apart."""
CROWD = 32
"""Pieces from which a pixel is cut into cells."""
GREATEST, LEAST, ID, AREA, NUMBERS = 3, 4, 5, 6, 9
"""In a piece's numbers, after its plane: bounds of its depth, its triangle's id, the share that is seen, and where."""


@loop
def settle(x, y, nearness, corner, ids, owner, share, begin, open_edges, x0, y0, width):
    """What is seen of every piece of a band, in place: its share of the pixel (0: hidden) and the centroid of what is
    seen. Returns how many pixels had to be given up."""
    pool, most, given_up = np.empty((64, SLOT)), 64, 0
    pieces, chosen, order = np.empty((most, NUMBERS)), np.empty((2, most), np.int64), np.empty(most, np.int64)
    sums = np.empty((most, 3))
    for place in range(len(begin) - 1):
        start, stop = begin[place], begin[place + 1]
        if stop - start < 2:
            continue
        total = 0.0
        for i in range(start, stop):
            total += share[0, i]
        if open_edges[place] == 0 and abs(total - 1) <= WHOLE:
            continue
        column, row, count = x0 + place % width, y0 + place // width, stop - start
        if count > most:
            most = 2 * count
            pieces, chosen, order = np.empty((most, NUMBERS)), np.empty((2, most), np.int64), np.empty(most, np.int64)
            sums = np.empty((most, 3))
        for i in range(count):
            chosen[0, i], chosen[1, i] = i, owner[start + i]
            for k in range(3):
                pieces[i, AREA + k] = share[k, start + i]
        sums[:count] = 0
        # Crowded pixels are cut into cells: most of those are settled at a glance.
        halvings = _halvings(count)
        lost = False
        for cell in range(1 << (2 * halvings)):
            shift = PIXEL - halvings
            across, down = cell & ((1 << halvings) - 1), cell >> halvings
            at = (column << halvings) + across, (row << halvings) + down, shift
            found = count
            if halvings:
                found = _gather(x, y, corner, owner, start, stop, at, chosen, pieces, pool)
            if _at_a_glance(x, y, nearness, corner, chosen, found, at, pieces, order):
                _add(sums, chosen, found, pieces, across, down, halvings)
                continue
            for i in range(found):
                _plane(x, y, nearness, corner, ids, chosen[1, i], at, pieces, i)
            _sort_again(pieces, order, found)
            used = _build_map(x, y, corner, chosen, found, at, pieces, order, pool)
            while used < 0 and len(pool) < MOST_PARTS:
                pool = np.empty((4 * len(pool), SLOT))
                used = _build_map(x, y, corner, chosen, found, at, pieces, order, pool)
            lost |= used < 0
            _sum_up(pool, abs(used), pieces, found)
            _add(sums, chosen, found, pieces, across, down, halvings)
        given_up += lost
        _write_back(share, start, sums, count)
    return given_up


@inner
def _write_back(share, start, sums, count):
    for i in range(count):
        area = sums[i, 0]
        share[0, start + i] = area if area > NOTHING else 0.0
        for k in range(1, 3):
            share[k, start + i] = min(max(sums[i, k] / area, 0.0), 1.0) if area > 0 else 0.0


@inner
def _halvings(count):
    """How often the sides of a pixel with so many pieces are halved."""
    halvings = 0
    while halvings < 4 and count > CROWD << (2 * halvings):
        halvings += 1
    return halvings


@inner
def _gather(x, y, corner, owner, start, stop, at, chosen, pieces, pool):
    """The pieces of a cell, their areas (of cells) and moments; how many there are."""
    column, row, shift = at
    left, top, side, found = column << shift, row << shift, 1 << shift, 0
    for i in range(stop - start):
        t = owner[start + i]
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        beside = (max(x[a], x[b], x[c]) <= left) | (min(x[a], x[b], x[c]) >= left + side)
        if beside | (max(y[a], y[b], y[c]) <= top) | (min(y[a], y[b], y[c]) >= top + side):
            continue
        _piece(pool, 2, x, y, a, b, c, at)
        if pool[2, SIZE] < 3:
            continue
        area, across, down = measure(pool, 2)
        if area > NOTHING:
            chosen[0, found], chosen[1, found] = i, t
            pieces[found, AREA] = area
            pieces[found, AREA + 1], pieces[found, AREA + 2] = across / area, down / area
            found += 1
    return found


@inner
def _add(sums, chosen, found, pieces, across, down, halvings):
    """What is seen in one cell to the sums for the pixel: area and moments."""
    side = 1.0 / (1 << halvings)
    for i in range(found):
        area = pieces[i, AREA] * side * side
        if area > 0:
            k = chosen[0, i]
            sums[k, 0] += area
            sums[k, 1] += area * (across + pieces[i, AREA + 1]) * side
            sums[k, 2] += area * (down + pieces[i, AREA + 2]) * side


@inner
def _at_a_glance(x, y, nearness, corner, chosen, found, at, pieces, order):
    """Whether it is plain what is seen; what is not loses its area.

    Where pieces fill the cell and every edge among them is closed, they do so once. Either all of them do, or the
    nearest that lie wholly before all others.
    """
    if found < 2:
        return True
    for i in range(found):
        t = chosen[1, i]
        a, b, c = nearness[corner[0, t]], nearness[corner[1, t]], nearness[corner[2, t]]
        pieces[i, GREATEST], pieces[i, LEAST] = max(a, b, c), min(a, b, c)
        order[i] = i
    _sort_again(pieces, order, found)
    total, back, open_edges, count = 0.0, np.inf, np.int64(0), 0
    while count < found and total < 1 - WHOLE:
        i = order[count]
        total += pieces[i, AREA]
        back = min(back, pieces[i, LEAST])
        count += 1
    if abs(total - 1) > WHOLE or (count < found and pieces[order[count], GREATEST] >= back):
        return False
    for k in range(count):
        t = chosen[1, order[k]]
        open_edges += edges_in(x, y, corner[0, t], corner[1, t], corner[2, t], at)
    if open_edges != 0:
        return False
    for k in range(count, found):
        pieces[order[k], AREA] = 0
    return True


@inner
def _sort_again(pieces, order, count):
    """By greatest depth, those of the same as they came (Shell's sort: it needs no room)."""
    gap = 1
    while gap < count // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, count):
            own, at = order[i], i
            depth = pieces[own, GREATEST]
            while at >= gap:
                other = order[at - gap]
                ahead = pieces[other, GREATEST]
                if ahead > depth or (ahead == depth and other < own):
                    break
                order[at] = other
                at -= gap
            order[at] = own
        gap //= 3


@inner
def _plane(x, y, nearness, corner, ids, t, at, pieces, i):
    """A triangle in a cell: nearness at its corner and changes over the cell; the greatest and least it may have."""
    a, b, c = corner[0, t], corner[1, t], corner[2, t]
    ax, ay = np.int64(x[a]), np.int64(y[a])
    twice = (x[b] - ax) * (y[c] - ay) - (x[c] - ax) * (y[b] - ay)
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
def _build_map(x, y, corner, chosen, found, at, pieces, order, pool):
    """The map of what is seen, in the pool's slots but the first two; how many slots it takes, negative where it had to
    be given up. Slots that nobody holds any more have the holder -1."""
    used, covered, back = 2, 0.0, np.inf
    for rank in range(found):
        i = order[rank]
        if covered >= 1 - _FULL and pieces[i, GREATEST] < back:
            break
        if used + 8 >= len(pool):
            return -used
        t, first = chosen[1, i], used
        _piece(pool, first, x, y, corner[0, t], corner[1, t], corner[2, t], at)
        if pool[first, SIZE] < 3:
            continue
        hold(pool, first, i)
        covered += measure(pool, first)[0]
        used, e = used + 1, 2
        while e < used:
            j = pool[e, HOLDER]
            if j >= 0 and j != i and not disjoint(pool, first, e) and not apart(pool, e, first):
                used, gone = _meet(pool, pieces, e, i, first, used)
                if used < 0:
                    return used
                covered -= gone
            e += 1
        used = _close_up(pool, first, used)
        back = min(back, pieces[i, LEAST])
    return used


@inner
def _close_up(pool, first, used):
    """Move the slots from `first` on that somebody holds together; returns how many are used then."""
    to = first
    for slot in range(first, used):
        if pool[slot, HOLDER] >= 0:
            if slot > to:
                copy(pool, slot, to)
            to += 1
    return to


@inner
def _meet(pool, pieces, e, i, first, used):
    """Settle a part of the map, slot e, against all parts (slots `first` to `used`) of the piece i that is coming in.
    Returns how many slots are used then (negative: no more room), and the area where both lay."""
    stop, gone = used, 0.0
    for w in range(first, stop):
        if pool[w, HOLDER] != i or disjoint(pool, w, e) or apart(pool, e, w):
            continue
        begin = used
        used, common = _subtract(pool, w, e, i, used)
        if used < 0:
            return used, gone
        if pool[common, SIZE] == 0:
            used = begin  # they touch, no more
            continue
        pool[w, HOLDER] = -1
        gone += measure(pool, common)[0]
        used, taken = _contest(pool, pieces, e, i, common, used)
        if used < 0 or taken:
            return used, gone
    return used, gone


@inner
def _subtract(pool, w, e, piece, used):
    """What of slot w lies outside slot e, as new slots of a piece; what lies inside is left in a scratch slot. Returns
    how many slots are used (negative: no more room) and which scratch slot it is."""
    source, into = w, 0
    for k in range(FIRST, FIRST + CORNER * int(pool[e, SIZE]), CORNER):
        a, b, c = pool[e, k + 2], pool[e, k + 3], pool[e, k + 4]
        if a == 0 and b == 0:
            continue
        if used + 4 >= len(pool) or not cut(pool, source, a, b, c, into, used):
            return -used, into
        if pool[used, SIZE] >= 3:
            hold(pool, used, piece)
            used += 1
        if pool[into, SIZE] < 3:
            pool[into, SIZE] = 0
            return used, into
        source, into = into, 1 - into
    if source == w:  # e is the whole pixel
        copy(pool, w, 0)
        source = 0
    return used, source


@inner
def _contest(pool, pieces, e, i, common, used):
    """Where slot e and the piece i both lie, `common` (a scratch slot): who is nearer? What the piece wins is taken
    from slot e and added to the piece. Returns how many slots are used (negative: no more room); whether e was cut."""
    j = int(pool[e, HOLDER])
    a, b, c = pieces[i, 1] - pieces[j, 1], pieces[i, 2] - pieces[j, 2], pieces[i, 0] - pieces[j, 0]
    noise = 1e-15 * (abs(pieces[i, 1]) + abs(pieces[i, 2]) + abs(pieces[i, 0])) + 1e-9
    low, high = np.inf, -np.inf
    for k in range(FIRST, FIRST + CORNER * int(pool[common, SIZE]), CORNER):
        ahead = a * pool[common, k] + b * pool[common, k + 1] + c
        low, high = min(low, ahead), max(high, ahead)
    if high <= noise and (low < -noise or pieces[j, ID] <= pieces[i, ID]):
        return used, False
    if used + 8 >= len(pool):
        return -used, False
    won = used
    if low >= -noise:
        copy(pool, common, won)
    else:
        length = np.sqrt(a * a + b * b)
        if not cut(pool, common, a / length, b / length, c / length, won, used + 1):
            return -used, False
        if pool[won, SIZE] < 3:
            return used, False
    hold(pool, won, i)
    used, _ = _subtract(pool, e, won, j, used + 1)
    pool[e, HOLDER] = -1
    return used, True


@inner
def _piece(pool, slot, x, y, a, b, c, at):
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


@inner
def _sum_up(pool, used, pieces, found):
    """Areas and centroids of what is seen of a cell's pieces."""
    total = 0.0
    for i in range(found):
        pieces[i, AREA] = pieces[i, AREA + 1] = pieces[i, AREA + 2] = 0.0
    for slot in range(2, used):
        i = int(pool[slot, HOLDER])
        if i >= 0:
            area, across, down = measure(pool, slot)
            pieces[i, AREA] += area
            pieces[i, AREA + 1] += across
            pieces[i, AREA + 2] += down
            total += area
    limit = max(total, 1.0)  # above 1 only where the cell was given up
    for i in range(found):
        area = pieces[i, AREA]
        if area > 0:
            pieces[i, AREA] = area / limit
            pieces[i, AREA + 1] /= area
            pieces[i, AREA + 2] /= area
