"""Which pixels each triangle touches, and how much of each, as loops for the CPU.

Pieces are overlaps of a triangle with a pixel; places are flat indices into the pixels of a band, rows of the window.
Areas come from edges alone, as font rasterizers have it: what lies to the right of each edge, with the edge's sign,
summed up along each row of pixels; so do first moments, for the centroid. Edges are walked from the top down,
whichever way a triangle lists them, so that two triangles that share one split a pixel without gap or overlap.

Notes are kept for each place. `open_edges`: the sum of a number for every edge that crosses the pixel, whose sign says
on which side the triangle lies. Where it is 0 every edge has a triangle on either side, so each point of the pixel lies
in equally many: where the areas also add up to 1, nothing overlaps and nothing is left out. `front`: the least nearness
of the nearest surface that fills the pixel; what lies behind is dropped before it is stored. Triangles that face the
camera come first, so that most that show their backs are.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner, loop
from cloak_core.render.visibility.covering_loops import doubled_area, in_order
from cloak_core.render.visibility.projection import GRID

NOTHING = 1e-9
"""Share of a pixel below which a piece is dropped."""
WHOLE = 1e-6
"""Shares that add up to 1 within this fill the pixel once where every edge is closed: else they add up to 0 or 2."""
PIXEL = GRID.bit_length() - 1
_MARGIN = 2.0**-36
"""Nearness by which a piece must lie behind to be dropped unseen; depths themselves are told apart by 2^-42."""
_MIX = 0x2545F4914F6CDD1D
_OTHER = 0x1B873593CC9E2D51
_START = 0x5851F42D4C957F2D
"""With this no place inside the guard band is 0, of which nothing can be told."""
_FAR = 1 << 30


@loop
def find_candidates(x, y, corner, one_sided, x0, x1, y0, y1):
    """Triangles that touch the window and have area, those that face the camera first: index and doubled area, first
    and last row; and for every row of the window how many pixels at most they touch there."""
    most, count, backs = corner.shape[1], 0, 0
    index, area = np.empty(most, np.int32), np.empty(most, np.int64)
    first, last = np.empty(most, np.int32), np.empty(most, np.int32)
    load = np.zeros(y1 - y0 + 1, np.int64)
    for t in range(most):
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        twice = doubled_area(x, y, a, b, c)
        if (twice == 0) | (one_sided[t] & (twice > 0)):
            continue
        r0, r1 = touched(y[a], y[b], y[c], y0, y1)
        c0, c1 = touched(x[a], x[b], x[c], x0, x1)
        if (c0 > c1) | (r0 > r1):
            continue
        at = count if twice < 0 else most - 1 - backs
        count, backs = count + (twice < 0), backs + (twice > 0)
        index[at], area[at], first[at], last[at] = t, twice, r0, r1
        load[r0 - y0] += c1 - c0 + 1
        load[r1 + 1 - y0] -= c1 - c0 + 1
    for row in range(1, len(load)):
        load[row] += load[row - 1]
    fronts = count, backs
    return _joined(index, fronts), _joined(area, fronts), _joined(first, fronts), _joined(last, fronts), load[:-1]


@loop
def _joined(values, counts):
    """The first so many values, then the last so many, from the end."""
    return np.concatenate((values[: counts[0]], values[len(values) - counts[1] :][::-1]))


@inner
def touched(a, b, c, start, stop):
    """First and last pixel from start to stop - 1 that a triangle touches along one axis."""
    low, high = np.int64(min(a, b, c)) >> PIXEL, (np.int64(max(a, b, c)) - 1) >> PIXEL
    return max(low, start), min(high, stop - 1)


@loop
def find_pieces(x, y, nearness, corner, hashes, candidates, x0, x1, y0, y1):
    """All pieces of a band: place, triangle (its index), area, and the centroid within the pixel; and `open_edges`."""
    index, areas, first, last, _ = candidates
    width, count, backs = x1 - x0, 0, False
    places = width * (y1 - y0)
    open_edges, front, total, least = (
        np.zeros(places, np.int64),
        np.zeros(places),
        np.zeros(places),
        np.full(places, 2.0),
    )
    place, owner, share = np.empty(1024, np.int32), np.empty(1024, np.int32), np.empty((3, 1024), np.float32)
    edges, signs, sums = np.empty((3, 6)), np.empty(3, np.int64), np.zeros((width + 1, 5))
    _fill_front(front, x, y, nearness, corner, candidates, x0, x1, y0, y1)
    for k in range(len(index)):
        t, twice = index[k], areas[k]
        if (twice > 0) & (not backs):
            backs = True
            _close(front, total, least, open_edges)
        if (last[k] < y0) | (first[k] >= y1):
            continue
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        c0, c1 = touched(x[a], x[b], x[c], x0, x1)
        r0, r1 = max(first[k], y0), min(last[k], y1 - 1)
        most = (c1 - c0 + 1) * (r1 - r0 + 1)
        if count + most > len(place):
            more = max(count + most, 2 * len(place))
            place, owner, share = longer(place, more), longer(owner, more), longer_rows(share, more)
        near, far = max(nearness[a], nearness[b], nearness[c]), min(nearness[a], nearness[b], nearness[c])
        if (most == 1) & within(x[a], x[b], x[c], c0, PIXEL) & within(y[a], y[b], y[c], r0, PIXEL):
            at, size = (r0 - y0) * width + c0 - x0, abs(twice) * (0.5 / (GRID * GRID))
            open_edges[at] += edges_in(x, y, hashes, a, b, c, twice, (c0, r0, PIXEL))
            if (size > NOTHING) & (near + _MARGIN >= front[at]):
                total[at] += size
                least[at] = min(least[at], far)
                place[count], owner[count], share[0, count] = at, t, size
                share[1, count], share[2, count] = _middle(x[a], x[b], x[c], c0), _middle(y[a], y[b], y[c], r0)
                count += 1
            continue
        _prepare(edges, signs, x, y, hashes, a, b, c, twice)
        # Small triangles have no need of their plane: their corners say enough.
        small = (c1 - c0 < 3) & (r1 - r0 < 3)
        plane = (a, 0.0, 0.0) if small else slopes(x, y, nearness, a, b, c, twice)
        for row in range(r0, r1 + 1):
            level, base = (near, far) if small else _level(x, y, nearness, plane, row), (row - y0) * width
            touched_here = _walk_row(edges, signs, sums, open_edges, row, x0, x1, base)
            count = _add_row(
                place, owner, share, count, t, touched_here, sums, front, total, least, level, plane, x, near, far,
                c0, c1, x0, base,
            )  # fmt: skip
    return place[:count], owner[:count], share[:, :count], open_edges


@inner
def _add_row(
    place, owner, share, count, t, touched_here, sums, front, total, least, level, plane, x, near, far, c0, c1, x0, base
):  # fmt: skip
    """Add the pieces of a triangle in a row of pixels, from what its edges add up to; how many there are now."""
    begin, end, carry, moment = touched_here
    for column in range(max(begin, c0), max(c1, end) + 1):
        own, at = sums[column - x0], base + column - x0
        area, mx, my = own[0] + carry, own[1] + carry / 2, own[2] + moment
        carry, moment = carry + own[3], moment + own[4]
        if column <= end:
            own[0] = own[1] = own[2] = own[3] = own[4] = 0.0
        elif area < NOTHING:
            break
        high, low = _bounds(level, plane, x, column, near, far)
        if (area > NOTHING) & (high + _MARGIN >= front[at]):
            total[at] += area
            least[at] = min(least[at], low)
            place[count], owner[count], share[0, count] = at, t, area
            share[1, count], share[2, count] = min(max(mx / area, 0.0), 1.0), min(max(my / area, 0.0), 1.0)
            count += 1
    return count


@inner
def _close(front, total, least, open_edges):
    """`front` from pieces that fill a pixel together."""
    for at in range(len(front)):
        if (open_edges[at] == 0) & (abs(total[at] - 1) <= WHOLE):
            front[at] = max(front[at], least[at] - _MARGIN)


@inner
def _prepare(edges, signs, x, y, hashes, a, b, c, twice):
    """A triangle's edges, each from its upper end (of two the left one): x, y, x, y, pixels; change of x with y; 1
    where the triangle lies on its right, -1 on its left. And the numbers that `open_edges` adds up."""
    for k in range(3):
        p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        if twice > 0:
            p, q = q, p
        # Now the triangle is counter-clockwise on the screen: it lies to the right of what goes down.
        signs[k] = edge_number(hashes, p, q)
        down = (y[p] < y[q]) | ((y[p] == y[q]) & (x[p] < x[q]))
        u, v = (p, q) if down else (q, p)
        edges[k, 0], edges[k, 1] = x[u] / GRID, y[u] / GRID
        edges[k, 2], edges[k, 3] = x[v] / GRID, y[v] / GRID
        height = edges[k, 3] - edges[k, 1]
        edges[k, 4] = (edges[k, 2] - edges[k, 0]) / height if height > 0 else 0.0
        edges[k, 5] = 1.0 if down else -1.0


@inner
def _walk_row(edges, signs, sums, open_edges, row, x0, x1, base):
    """What the edges add in a row of pixels, to `sums` [width + 1, 5]: area and moments right of them within the pixel,
    area and moment in y for every pixel to the right. Returns the first and last column they touch, and area and moment
    that come in from the left."""
    begin, end, carry, moment = np.int64(x1), np.int64(x0), 0.0, 0.0
    for k in range(3):
        xt, yt, xb, yb, slope, side = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3], edges[k, 4], edges[k, 5]
        if (yb <= row) | (yt >= row + 1):
            continue
        v0, v1, u0, u1 = yt - row, yb - row, xt, xb
        low, high = min(xt, xb), max(xt, xb)
        if v0 < 0:
            v0, u0 = 0.0, min(max(xt + (row - yt) * slope, low), high)
        if v1 > 1:
            v1, u1 = 1.0, min(max(xt + (row + 1 - yt) * slope, low), high)
        if u1 < u0:  # from left to right
            u0, v0, u1, v1 = u1, v1, u0, v0
        column, stop = np.int64(np.floor(u0)), np.int64(np.ceil(u1)) - 1
        slant = (v1 - v0) / (u1 - u0) if u1 > u0 else 0.0
        if column < x0:
            beyond = v1 if u1 <= x0 else v0 + (x0 - u0) * slant
            part = side * abs(beyond - v0)
            carry, moment = carry + part, moment + part * (v0 + beyond) / 2
            if u1 <= x0:
                begin = np.int64(x0)
                continue
            u0, v0, column = float(x0), beyond, np.int64(x0)
        begin, end = min(begin, column), max(end, min(max(stop, column), x1 - 1))
        while column < x1:
            u, v = (u1, v1) if column >= stop else (column + 1.0, v0 + (column + 1 - u0) * slant)
            _add_edge(sums, column - x0, u0 - column, v0, u - column, v, side)
            if (u0 > column) | (u > column):
                open_edges[base + column - x0] += signs[k]
            if column >= stop:
                break
            u0, v0, column = u, v, column + 1
    return begin, end, carry, moment


@inner
def _add_edge(sums, at, u0, v0, u1, v1, side):
    """A part of an edge within one pixel."""
    part, middle = side * abs(v1 - v0), (v0 + v1) / 2
    sums[at, 0] += part * (1 - (u0 + u1) / 2)
    sums[at, 1] += part * (1 - (u0 * u0 + u0 * u1 + u1 * u1) / 3) / 2
    sums[at, 2] += part * (middle - (2 * u0 * v0 + u0 * v1 + u1 * v0 + 2 * u1 * v1) / 6)
    sums[at, 3] += part
    sums[at, 4] += part * middle


@loop
def longer(values, more):
    result = np.empty(more, values.dtype)
    result[: len(values)] = values
    return result


@loop
def longer_rows(values, more):
    result = np.empty((values.shape[0], more), values.dtype)
    result[:, : values.shape[1]] = values
    return result


@inner
def within(a, b, c, cell, shift):
    """Whether an extent lies within one cell (2^shift grid units)."""
    return (np.int64(min(a, b, c)) >= cell << shift) & (np.int64(max(a, b, c)) <= (cell + 1) << shift)


@inner
def _middle(a, b, c, pixel):
    return ((np.int64(a) + b + c) - 3 * (pixel << PIXEL)) * (1 / (3 * GRID))


@inner
def edges_in(x, y, hashes, a, b, c, twice, at):
    """The sum over a triangle's edges that may cross the inside of a cell (its column, row and size as a shift)."""
    turn = -1 if twice > 0 else 1
    return turn * (_edge(x, y, hashes, a, b, at) + _edge(x, y, hashes, b, c, at) + _edge(x, y, hashes, c, a, at))


@inner
def _edge(x, y, hashes, a, b, at):
    return edge_number(hashes, a, b) if may_cross(x, y, a, b, at) else np.int64(0)


@inner
def may_cross(x, y, a, b, at):
    """Whether the box of an edge reaches into a cell."""
    column, row, shift = at
    left, top, side = column << shift, row << shift, 1 << shift
    across = (max(x[a], x[b]) > left) & (min(x[a], x[b]) < left + side)
    return across & (max(y[a], y[b]) > top) & (min(y[a], y[b]) < top + side)


@loop
def hash_corners(x, y):
    """Two numbers for every corner [2, K], of which `edge_number` makes those of edges. By where corners are, not by
    which they are: seams of a mesh are closed, too."""
    hashes = np.empty((2, len(x)), np.int64)
    for i in range(len(x)):
        key = _START ^ (np.int64(y[i]) << 32) ^ x[i]
        hashes[0, i], hashes[1, i] = _first(key), _second(key)
    return hashes


@inner
def edge_number(hashes, a, b):
    """Of two triangles on either side of an edge one gets the negative of what the other gets, as both ask the same of
    the edge alone."""
    return hashes[0, a] * hashes[1, b] - hashes[0, b] * hashes[1, a]


@inner
def _first(key):
    key = (key ^ (key >> 29)) * np.int64(_MIX)
    return key ^ (key >> 32)


@inner
def _second(key):
    key = (key ^ (key >> 31)) * np.int64(_OTHER)
    return key ^ (key >> 30)


@inner
def slopes(x, y, nearness, a, b, c, twice):
    """A triangle's nearness as a plane: its first corner in canonical order, what nearness changes by from a grid unit
    to the next, right and down."""
    p0, p1, p2 = in_order(x, y, a, b, c, twice)
    size = float(abs(twice))
    slope1, slope2 = (nearness[p1] - nearness[p0]) / size, (nearness[p2] - nearness[p0]) / size
    d1x, d1y = np.int64(x[p1]) - x[p0], np.int64(y[p1]) - y[p0]
    d2x, d2y = np.int64(x[p2]) - x[p0], np.int64(y[p2]) - y[p0]
    return p0, d2y * slope1 - d1y * slope2, d1x * slope2 - d2x * slope1


@inner
def _level(x, y, nearness, plane, row):
    """Nearness of a plane in a row of pixels, at its first corner's x: the greatest and the least."""
    p0, _, down = plane
    top = nearness[p0] + ((row << PIXEL) - np.int64(y[p0])) * down
    return top + max(down * GRID, 0.0), top + min(down * GRID, 0.0)


@inner
def _bounds(level, plane, x, column, near, far):
    """The greatest and least nearness that a triangle may have in a pixel."""
    high, low = level
    p0, across, _ = plane
    left = ((column << PIXEL) - np.int64(x[p0])) * across
    return min(near, high + left + max(across * GRID, 0.0)), max(far, low + left + min(across * GRID, 0.0))


@inner
def _fill_front(front, x, y, nearness, corner, candidates, x0, x1, y0, y1):
    """`front` from all triangles that fill pixels of the band."""
    index, areas, first, last, _ = candidates
    width = x1 - x0
    for k in range(len(index)):
        if (last[k] - first[k] < 2) | (last[k] < y0) | (first[k] >= y1):
            continue
        t, twice = index[k], areas[k]
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        left, right = touched(x[a], x[b], x[c], -_FAR, _FAR)
        if right - left < 2:
            continue
        plane = slopes(x, y, nearness, a, b, c, twice)
        far = min(nearness[a], nearness[b], nearness[c])
        for row in range(max(first[k], y0), min(last[k], y1 - 1) + 1):
            above, below = _span(x, y, a, b, c, row << PIXEL), _span(x, y, a, b, c, (row + 1) << PIXEL)
            begin = np.int64(np.ceil(max(above[0], below[0]) + 1e-6))
            end = np.int64(np.floor(min(above[1], below[1]) - 1e-6)) - 1
            if begin > end:
                continue
            level = _level(x, y, nearness, plane, row)
            for column in range(max(begin, x0), min(end, x1 - 1) + 1):
                low = _bounds(level, plane, x, column, 2.0, far)[1]
                at = (row - y0) * width + column - x0
                front[at] = max(front[at], low - _MARGIN)


@inner
def _span(x, y, a, b, c, level):
    """From where to where, pixels, a triangle reaches at a level of y (grid units); nowhere: from right to left."""
    low, high = np.inf, -np.inf
    for k in range(3):
        p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        if (min(y[p], y[q]) <= level) & (max(y[p], y[q]) >= level) & (y[p] != y[q]):
            at = (x[p] + (level - np.int64(y[p])) / (np.int64(y[q]) - y[p]) * (np.int64(x[q]) - x[p])) / GRID
            low, high = min(low, at), max(high, at)
    return low, high


@loop
def by_place(place, owner, share, places):
    """The pieces in order of place, those of one place as they came; and where each place's begin, [places + 1]."""
    begin = np.zeros(places + 1, np.int64)
    for p in place:
        begin[p + 1] += 1
    for p in range(places):
        begin[p + 1] += begin[p]
    following = begin[:-1].copy()
    sorted_owner, sorted_share = np.empty_like(owner), np.empty_like(share)
    for i in range(len(place)):
        at = following[place[i]]
        following[place[i]] = at + 1
        sorted_owner[at] = owner[i]
        for k in range(3):
            sorted_share[k, at] = share[k, i]
    return sorted_owner, sorted_share, begin
