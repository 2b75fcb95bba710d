"""Hidden surface removal in one pixel by clipping, as numba loops (after Weiler and Atherton 1977, convex parts alone).

From each piece is cut away what nearer ones hide of it: the part of the piece inside another triangle where that one is
nearer is convex, so what stays is a list of convex parts. Triangles that pierce each other are cut along their line.

Depth is a plane for each piece, three whole numbers: inverse depth at the pixel's corner times 2^42, and its change
over the pixel right and down. Differences of whole numbers do not round, so of any three triangles the order is
without contradiction; equal ones go to the lower id.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner
from cloak_core.render.cpu.polygons import TOUCH, copy, cut, line_through, measure, reach
from cloak_core.render.cpu.triangles import doubled_area, in_order
from cloak_core.render.cpu.workspace import FIELDS, MOST_PARTS

DEPTH_STEPS = 2.0**42
"""Steps of inverse depth that are told apart."""
MOST_PIECES = 4096
"""Pieces of a pixel that are resolved exactly at most: each is compared with each."""
_PARTS = 2
"""The first polygon of the pool that is a part of a piece; those before it are workspace."""
_NOTHING = 1e-15
_BEHIND, _NEARER, _PARTLY = 0, 1, 2


@inner
def cut_hidden(mesh, at, found, work, most):
    """Measure the visible part of each of a pixel's pieces: area and moments to `visible`, area -1 for all of it.

    at: column, row and size (as a shift) of the pixel. Returns how many tests of a convex part against a triangle it
    took, and False where that is more than `most`, or too many pieces or parts; `visible` is unfinished then.
    """
    if found > MOST_PIECES:
        return 0, False
    pieces, visible, pool, cuts = work.pieces, work.visible, work.pool, 0
    for i in range(found):
        work.fields[i] = _describe(mesh, work.chosen[i], at, pieces, i)
    for i in range(found):
        held, end = _find_hiders(pieces, work.fields, i, found, work.hiders), 0
        for k in range(held):
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
                break
        visible[i, 0] = -1.0 if end == 0 else 0.0
        visible[i, 1] = visible[i, 2] = 0.0
        for slot in range(_PARTS, end):
            area, across, down = measure(pool, slot)
            visible[i, 0] += area
            visible[i, 1] += across
            visible[i, 2] += down
    return cuts, True


@inner
def _describe(mesh, t, at, pieces, i):
    """Write piece i, triangle t in the pixel's coordinates; returns the fields that its box touches, as bits."""
    a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
    x, y = mesh.x, mesh.y
    p0, p1, p2 = in_order(x, y, a, b, c, doubled_area(x, y, a, b, c))
    column, row, shift = at
    side = 1 << shift
    x0, y0 = np.int64(x[p0]) - (column << shift), np.int64(y[p0]) - (row << shift)
    d1x, d1y = x[p1] - np.int64(x[p0]), y[p1] - np.int64(y[p0])
    d2x, d2y = x[p2] - np.int64(x[p0]), y[p2] - np.int64(y[p0])
    depths = mesh.inverse_depth[p0], mesh.inverse_depth[p1], mesh.inverse_depth[p2]
    _set_plane(pieces, i, (x0, y0), (d1x, d1y), (d2x, d2y), side, depths)
    pieces[i].id = mesh.ids[t]
    unit, own = 1.0 / side, pieces[i]
    x0, y0, x1, y1, x2, y2 = (
        x0 * unit, y0 * unit, (x0 + d1x) * unit, (y0 + d1y) * unit, (x0 + d2x) * unit, (y0 + d2y) * unit
    )  # fmt: skip
    own.corner[0], own.corner[1], own.corner[2] = x0, y0, x1
    own.corner[3], own.corner[4], own.corner[5] = y1, x2, y2
    own.box[0], own.box[1] = max(min(x0, x1, x2), 0.0), max(min(y0, y1, y2), 0.0)
    own.box[2], own.box[3] = min(max(x0, x1, x2), 1.0), min(max(y0, y1, y2), 1.0)
    own.line[0], own.line[1], own.line[2] = line_through(x0, y0, x1, y1)
    own.line[3], own.line[4], own.line[5] = line_through(x1, y1, x2, y2)
    own.line[6], own.line[7], own.line[8] = line_through(x2, y2, x0, y0)
    return _fields(own.box[0], own.box[1], own.box[2], own.box[3])


@inner
def _set_plane(pieces, i, first, edge1, edge2, side, depths):
    """Write the plane of inverse depth, in steps, and its bounds within the pixel."""
    (x0, y0), (d1x, d1y), (d2x, d2y), (n0, n1, n2) = first, edge1, edge2, depths
    size = float(abs(d1x * d2y - d1y * d2x))
    e1, e2 = d2x * y0 - d2y * x0, d1y * x0 - d1x * y0
    slope1, slope2 = (n1 - n0) / size, (n2 - n0) / size
    begin = _steps(e1, e2, slope1, slope2, n0)
    across = _steps(e1 + d2y * side, e2 - d1y * side, slope1, slope2, n0) - begin
    down = _steps(e1 - d2x * side, e2 + d1x * side, slope1, slope2, n0) - begin
    own = pieces[i]
    own.plane[0], own.plane[1], own.plane[2] = begin, across, down
    most, least = np.ceil(max(n0, n1, n2) * DEPTH_STEPS) + 1, np.floor(min(n0, n1, n2) * DEPTH_STEPS) - 1
    own.bounds[0] = max(begin + min(across, 0.0) + min(down, 0.0), least)
    own.bounds[1] = min(begin + max(across, 0.0) + max(down, 0.0), most)


@inner
def _steps(e1, e2, slope1, slope2, n0):
    return np.rint(((float(e1) * slope1 + float(e2) * slope2) + n0) * DEPTH_STEPS)


@inner
def _fields(left, top, right, bottom):
    """List the fields that a box touches, as bits."""
    u0, u1 = np.int64(left * FIELDS), min(np.int64(right * FIELDS), FIELDS - 1)
    v0, v1 = np.int64(top * FIELDS), min(np.int64(bottom * FIELDS), FIELDS - 1)
    row, bits = (np.int64(2) << u1) - (np.int64(1) << u0), np.int64(0)
    for v in range(v0, v1 + 1):
        bits |= row << (v * FIELDS)
    return bits


@inner
def _find_hiders(pieces, fields, i, found, hiders):
    """List the pieces whose boxes meet piece i and that are not behind it there; returns how many.

    Branch-free: the branch is unpredictable.
    """
    near, held, mine = 0, 0, fields[i]
    for q in range(found):
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
