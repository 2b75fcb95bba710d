"""What is in front within one cell of a pixel, as loops for the CPU: pieces cut against each other, no samples.

A map of what is seen is kept, convex parts that do not overlap. Pieces enter it from front to back; each is cut against
every part that it meets: where the part is nearer the piece goes, where the piece is nearer the part goes, and planes
that pierce each other are cut along their line. So the parts always cover just the union of what came in, whatever
their depths say. Once they fill the cell, what lies behind all of them needs no look.

Depth is a plane for each triangle, three whole numbers: nearness at the cell's corner times 2^42, and what it changes
by over the cell right and down. Differences of whole numbers do not round, so of any three triangles the order is
without contradiction; equal ones go to the lower id.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner
from cloak_core.render.visibility.plane_loops import GREATEST, ID, LEAST
from cloak_core.render.visibility.polygon_loops import (
    CORNER,
    FIRST,
    HOLDER,
    SIZE,
    apart,
    copy,
    cut,
    disjoint,
    hold,
    measure,
)  # fmt: skip

_FULL = 1e-11
_LITTLE = 1e-10
"""Share of a cell that is not worth a cut."""


@inner
def build_map(pool, pieces, items, order, area, base):
    """The map of what is seen of convex pieces in a cell of so much area, in the pool's slots from `base` on; how many
    slots are used then, negative where the room did not do. Slots that nobody holds any more have the holder -1.

    items: the pieces' slots; order: scratch, as long. Slots 0 and 1 are scratch, too.
    """
    for k in range(len(items)):
        order[k] = items[k]
    _sort(pool, pieces, order)
    used, covered, back = base, 0.0, np.inf
    for slot in order[: len(items)]:
        i = int(pool[slot, HOLDER])
        if covered >= area - _FULL and pieces[i, GREATEST] < back:
            break
        if used + 8 >= len(pool):
            return -used
        first = used
        copy(pool, slot, first)
        hold(pool, first, i)
        covered += measure(pool, first)[0]
        used, e = used + 1, base
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
def _sort(pool, pieces, order):
    """By greatest nearness, those of the same as they came (Shell's sort: it needs no room)."""
    count, gap = len(order), 1
    while gap < count // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, count):
            own, at = order[i], i
            depth = pieces[int(pool[own, HOLDER]), GREATEST]
            while at >= gap:
                other = order[at - gap]
                ahead = pieces[int(pool[other, HOLDER]), GREATEST]
                if ahead > depth or (ahead == depth and other < own):
                    break
                order[at] = other
                at -= gap
            order[at] = own
        gap //= 3


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
    low, high = ahead(pool, pieces, i, j, common)
    if high == 0 and (low < 0 or pieces[j, ID] <= pieces[i, ID]):
        return used, False
    if used + 8 >= len(pool):
        return -used, False
    won = used
    if low == 0:
        copy(pool, common, won)
    else:
        a, b, c = pieces[i, 1] - pieces[j, 1], pieces[i, 2] - pieces[j, 2], pieces[i, 0] - pieces[j, 0]
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
def ahead(pool, pieces, i, j, slot):
    """By how much piece i is nearer than piece j at the corners of a polygon: the least, not above 0, and the greatest,
    not below. 0 stands for what next to nothing of the polygon's area can show, too."""
    a, b, c = pieces[i, 1] - pieces[j, 1], pieces[i, 2] - pieces[j, 2], pieces[i, 0] - pieces[j, 0]
    noise = 1e-15 * (abs(pieces[i, 1]) + abs(pieces[i, 2]) + abs(pieces[i, 0])) + 1e-9
    low, high = np.inf, -np.inf
    for k in range(FIRST, FIRST + CORNER * int(pool[slot, SIZE]), CORNER):
        here = a * pool[slot, k] + b * pool[slot, k + 1] + c
        low, high = min(low, here), max(high, here)
    low, high = (low if low < -noise else 0.0), (high if high > noise else 0.0)
    if low < 0 < high:
        # A line that parts a convex area off up to a share s of its width parts off at most 2 s of the area.
        little = _LITTLE / (2 * measure(pool, slot)[0]) * (high - low)
        low, high = (low if -low > little else 0.0), (high if high > little else 0.0)
    return low, high
