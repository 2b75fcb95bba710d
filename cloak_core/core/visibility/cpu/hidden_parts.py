"""Hidden surface removal in one pixel by clipping, as numba loops (after Weiler and Atherton 1977, convex parts alone).

From each piece is cut away what nearer ones hide of it: the part of the piece inside another triangle where that one is
nearer is convex, so what stays is a list of convex parts. Triangles that pierce each other are cut along their line.

Pieces are taken nearest first. What is hidden hides nothing more than its own hiders do, so it is not asked again, and
once the pixel is full, all that lies behind what has been taken is hidden. Depths are compared as described in
workspace.py: of any three triangles the order is without contradiction; equal ones go to the lower id.
"""

from __future__ import annotations

import numpy as np

from cloak_core.core.visibility.compiled import inner, loop
from cloak_core.core.visibility.cpu.edge_hash import WHOLE, edge_sum
from cloak_core.core.visibility.cpu.pieces import NOTHING
from cloak_core.core.visibility.cpu.polygons import TOUCH, copy, cut, measure, reach
from cloak_core.core.visibility.cpu.triangles import doubled_area
from cloak_core.core.visibility.cpu.workspace import MOST_PARTS, describe

MOST_PIECES = 4096
"""Pieces of a pixel that are resolved exactly at most: each is compared with each."""
FULL = 1 - 2e-7
"""Share of a pixel from which nothing is seen behind; shares are float32."""
_PARTS = 2
"""The first polygon of the pool that is a part of a piece; those before it are workspace."""
_LEAST = 1e-15
"""Area below which a part is dropped."""
_BEHIND, _NEARER, _PARTLY = 0, 1, 2


@loop
def cut_hidden(mesh, at, owner, share, work, most):
    """Reduce a pixel's pieces to what is visible of them.

    at: column, row and size (as a shift) of the pixel; owner [n]: the triangle of each piece; share [3, n]: area (0:
    hidden) and centroid, changed in place. Returns how many tests of a convex part against a triangle it took, and
    False where that is more than `most`, or too many pieces or parts; `share` is unfinished then.
    """
    found = len(owner)
    if found > MOST_PIECES:
        return 0, False
    pieces, cuts, seen, far = work.pieces, 0, 0.0, np.inf
    for i in range(found):
        work.fields[i] = describe(mesh, owner[i], at, pieces, i)
        work.behind[i] = -pieces[i].bounds[1]
    order = work.order[:found]
    _sort(order, work.behind)
    whole, left = _closed_front(mesh, at, owner, share, order, pieces)
    for k in range(left if whole < left else 0):
        i = order[k]
        if (seen >= FULL) & (pieces[i].bounds[1] < far):
            left = k
            break
        used, fits = _cut_piece(i, order, left, share, work, most - cuts)
        cuts += used
        if not fits:
            return cuts, False
        seen, far = seen + share[0, i], min(far, pieces[i].bounds[0])
    for k in range(left, found):
        share[0, order[k]] = 0.0
    return cuts, True


@inner
def _sort(order, behind):
    """Sort pieces, nearest first (Shell 1959); allocates nothing, which pixels of few pieces would wait for."""
    gap = 1
    while gap < len(order) // 3:
        gap = 3 * gap + 1
    for k in range(len(order)):
        order[k] = k
    while gap > 0:
        for k in range(gap, len(order)):
            i, at = order[k], k
            while at >= gap and behind[order[at - gap]] > behind[i]:
                order[at] = order[at - gap]
                at -= gap
            order[at] = i
        gap //= 3


@inner
def _closed_front(mesh, at, owner, share, order, pieces):
    """Count the nearest pieces that fill the pixel without overlap, and those behind which nothing is seen.

    Without boundary edges among them (edge_hash.py) and with the area of the pixel they cover each point once. Both
    counts are those of all pieces where there are no such nearest ones.
    """
    hashes, area, far, whole = np.int64(0), 0.0, np.inf, -1
    for k in range(len(order)):
        i = order[k]
        if whole >= 0:
            if pieces[i].bounds[1] < far:
                return whole, k
            continue
        a, b, c = mesh.corner[0, owner[i]], mesh.corner[1, owner[i]], mesh.corner[2, owner[i]]
        twice = doubled_area(mesh.x, mesh.y, a, b, c)
        hashes += edge_sum(mesh.x, mesh.y, mesh.hashes, a, b, c, twice, at)
        area, far = area + share[0, i], min(far, pieces[i].bounds[0])
        if (hashes == 0) & (abs(area - 1) <= WHOLE):
            whole = k + 1
    return whole, len(order)


@inner
def _cut_piece(i, order, left, share, work, most):
    """Measure what is visible of piece i; returns how many tests it took, and False where they are more than `most`."""
    pieces, pool, end, cuts = work.pieces, work.pool, 0, 0
    for k in range(_find_hiders(work, i, order, left)):
        q = work.hiders[k]
        if q == i or _beside(pieces, i, q):
            continue
        depth = _depth(pieces, i, q)
        if depth == _BEHIND:
            continue
        if end == 0:
            end = _PARTS + _polygon(pool, _PARTS, pieces, i)
        cuts += end - _PARTS
        end, fits = _take_away(pool, pieces, i, q, depth, end)
        if not fits or cuts > most:
            return cuts, False
        if end == _PARTS:
            work.fields[i] = 0
            break
    if end > 0:
        area = across = down = 0.0
        for slot in range(_PARTS, end):
            part = measure(pool, slot)
            area, across, down = area + part[0], across + part[1], down + part[2]
        share[0, i] = area if area > NOTHING else 0.0
        share[1, i] = min(max(across / area, 0.0), 1.0) if area > 0 else 0.0
        share[2, i] = min(max(down / area, 0.0), 1.0) if area > 0 else 0.0
    return cuts, True


@inner
def _find_hiders(work, i, order, left):
    """List the pieces whose boxes meet piece i and that are not behind it there; returns how many.

    Branch-free within the loops: the branch is unpredictable.
    """
    pieces, fields, hiders, near, held = work.pieces, work.fields, work.hiders, 0, 0
    mine, low = fields[i], pieces[i].bounds[0]
    for k in range(left):
        q = order[k]
        if -work.behind[q] < low:
            break
        hiders[near] = q
        near += (fields[q] & mine) != 0
    for k in range(near):
        q = hiders[k]
        hiders[held] = q
        held += _may_hide(pieces, i, q)
    return held


@inner
def _overlap(pieces, i, q):
    """Intersect two boxes: left, top, right, bottom."""
    one, other = pieces[i].box, pieces[q].box
    left, right = max(one[0], other[0]), min(one[2], other[2])
    return left, max(one[1], other[1]), right, min(one[3], other[3])


@inner
def _ahead(pieces, i, q):
    """Subtract two planes: how much nearer piece q is than piece i."""
    one, other = pieces[i].plane, pieces[q].plane
    return other[0] - one[0], other[1] - one[1], other[2] - one[2]


@inner
def _may_hide(pieces, i, q):
    """Test whether boxes meet and piece q is not behind piece i there."""
    left, top, right, bottom = _overlap(pieces, i, q)
    c, a, b = _ahead(pieces, i, q)
    ahead = c + max(a * left, a * right) + max(b * top, b * bottom)
    meet = (left < right - TOUCH) & (top < bottom - TOUCH)
    return meet & (ahead >= 0) & (pieces[q].bounds[1] >= pieces[i].bounds[0])


@inner
def _depth(pieces, i, q):
    """Tell whether piece q is nearer than piece i wherever boxes meet, or in a part of that, or nowhere."""
    left, top, right, bottom = _overlap(pieces, i, q)
    c, a, b = _ahead(pieces, i, q)
    if (a == 0) & (b == 0) & (c == 0):
        return _NEARER if pieces[q].id < pieces[i].id else _BEHIND
    if c + max(a * left, a * right) + max(b * top, b * bottom) <= 0:
        return _BEHIND
    return _NEARER if c + min(a * left, a * right) + min(b * top, b * bottom) >= 0 else _PARTLY


@inner
def _beside(pieces, i, q):
    """Test whether an edge of triangle i has all of triangle q on its outer side, or boxes do no more than touch."""
    left, top, right, bottom = _overlap(pieces, i, q)
    if (left >= right - TOUCH) | (top >= bottom - TOUCH):
        return True
    line, corner = pieces[i].line, pieces[q].corner
    for k in range(0, 9, 3):
        a, b, c, high = line[k], line[k + 1], line[k + 2], -1.0
        for n in range(0, 6, 2):
            high = max(high, a * corner[n] + b * corner[n + 1] + c)
        if high <= TOUCH:
            return True
    return False


@inner
def _take_away(pool, pieces, i, q, depth, end):
    """Cut away from the parts of piece i what piece q hides; returns the end of the parts, and whether all fit."""
    c, a, b = _ahead(pieces, i, q)
    scale = 1 / np.sqrt(a * a + b * b) if depth == _PARTLY else 0.0
    nearer = a * scale, b * scale, c * scale
    for slot in range(end - 1, _PARTS - 1, -1):
        crossed, missed = _crossed(pool, slot, pieces, q, depth, nearer)
        if missed:
            continue
        source, into = slot, 0
        for k in range(4):
            if not crossed & (1 << k):
                continue
            u, v, w = _line(pieces, q, k, nearer)
            if end >= MOST_PARTS or not cut(pool, source, u, v, w, into, end):
                return end, False
            end += (pool[end, 0] >= 3) and (measure(pool, end)[0] > _LEAST)
            if pool[into, 0] < 3:
                break
            source, into = into, 1 - into
        end -= 1
        if slot < end:
            copy(pool, end, slot)
    return end, True


@inner
def _line(pieces, q, k, nearer):
    """Return an edge of a piece's triangle, or after these the line where it is as near as another."""
    if k == 3:
        return nearer
    line = pieces[q].line
    return line[3 * k], line[3 * k + 1], line[3 * k + 2]


@inner
def _crossed(pool, slot, pieces, q, depth, nearer):
    """Find the lines around a hider that cross a part, as bits, and whether the part lies beyond any of them."""
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
    """Cut a piece's triangle to the pixel, into a slot; returns whether anything is left."""
    pool[slot, 0] = 3
    for k in range(6):
        pool[slot, 1 + k] = pieces[i].corner[k]
    for k in range(4):
        sign = 1.0 if k % 2 == 0 else -1.0
        a, b, c = sign if k < 2 else 0.0, sign if k >= 2 else 0.0, 0.0 if k % 2 == 0 else 1.0
        if reach(pool, slot, a, b, c)[1] < 0:
            cut(pool, slot, a, b, c, 0, 1)
            copy(pool, 0, slot)
    return pool[slot, 0] >= 3
