"""Which pixels each triangle touches, and how much of each, as loops for the CPU.

Pieces are overlaps of a triangle with a pixel; places are flat indices into the pixels of a band, rows of the window.
Every piece comes out of the triangle's own corners, so that it does not depend on the band.

Two notes are kept for each place. `open_edges`: the sum of a number for every edge that crosses the pixel, whose sign
turns with the edge. Where it is 0 every edge is shared by two triangles on either side of it, so each point of the
pixel lies in equally many: where the areas also add up to 1, nothing overlaps and nothing is left out. `front`: the
least nearness of the nearest triangle that fills the pixel; what lies behind is dropped before it is stored.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner, loop
from cloak_core.render.covering_loops import doubled_area, in_order
from cloak_core.render.projection import GRID

NOTHING = 1e-9
"""Share of a pixel below which a piece is dropped."""
PIXEL = GRID.bit_length() - 1
_MARGIN = 2.0**-36
"""Nearness by which a piece must lie behind to be dropped unseen; depths themselves are told apart by 2^-42."""
_MIX = 0x2545F4914F6CDD1D
_OTHER = 0x1B873593CC9E2D51


@loop
def find_candidates(x, y, corner, cull, x0, x1, y0, y1):
    """Triangles that touch the window and have area, by index, each with its doubled area and its first and last row;
    and for every row of the window how many pixels at most they touch there."""
    count, most = 0, corner.shape[1]
    index, area = np.empty(most, np.int32), np.empty(most, np.int64)
    first, last = np.empty(most, np.int32), np.empty(most, np.int32)
    load = np.zeros(y1 - y0 + 1, np.int64)
    for t in range(most):
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        twice = doubled_area(x, y, a, b, c)
        if (twice == 0) | (cull & (twice > 0)):
            continue
        r0, r1 = touched(y[a], y[b], y[c], y0, y1)
        c0, c1 = touched(x[a], x[b], x[c], x0, x1)
        if (c0 > c1) | (r0 > r1):
            continue
        index[count], area[count], first[count], last[count] = t, twice, r0, r1
        count += 1
        load[r0 - y0] += c1 - c0 + 1
        load[r1 + 1 - y0] -= c1 - c0 + 1
    for row in range(1, len(load)):
        load[row] += load[row - 1]
    return index[:count].copy(), area[:count].copy(), first[:count].copy(), last[:count].copy(), load[:-1]


@inner
def touched(a, b, c, start, stop):
    """First and last pixel from start to stop - 1 that a triangle touches along one axis."""
    low, high = np.int64(min(a, b, c)) >> PIXEL, (np.int64(max(a, b, c)) - 1) >> PIXEL
    return max(low, start), min(high, stop - 1)


@loop
def find_pieces(x, y, nearness, corner, candidates, x0, x1, y0, y1):
    """All pieces of a band: place, triangle (its index), area, and the centroid within the pixel; and `open_edges`."""
    index, areas, first, last, _ = candidates
    width, count = x1 - x0, 0
    open_edges, front = np.zeros(width * (y1 - y0), np.int64), np.zeros(width * (y1 - y0), np.float64)
    place, owner, share = np.empty(1024, np.int32), np.empty(1024, np.int32), np.empty((3, 1024), np.float32)
    shapes = np.empty((5, 8, 2))
    _fill_front(front, x, y, nearness, corner, candidates, shapes, x0, x1, y0, y1)
    for k in range(len(index)):
        if (last[k] < y0) | (first[k] >= y1):
            continue
        t, twice = index[k], areas[k]
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        c0, c1 = touched(x[a], x[b], x[c], x0, x1)
        r0, r1 = max(first[k], y0), min(last[k], y1 - 1)
        most = (c1 - c0 + 1) * (r1 - r0 + 1)
        near = max(nearness[a], nearness[b], nearness[c]) + _MARGIN
        if most == 1:
            at = (r0 - y0) * width + c0 - x0
            hidden = near < front[at]
            most = 0 if hidden else most
            open_edges[at] += edges_in(x, y, a, b, c, (c0, r0, PIXEL))
        if count + most > len(place):
            more = max(count + most, 2 * len(place))
            place, owner, share = longer(place, more), longer(owner, more), _longer_rows(share, more)
        if (most == 1) & within(x[a], x[b], x[c], c0, PIXEL) & within(y[a], y[b], y[c], r0, PIXEL):
            size = abs(twice) * (0.5 / (GRID * GRID))
            if size > NOTHING:
                place[count], owner[count], share[0, count] = at, t, size
                share[1, count] = _middle(x[a], x[b], x[c], c0)
                share[2, count] = _middle(y[a], y[b], y[c], r0)
                count += 1
            continue
        if most == 0:
            continue
        if most > 1:
            _note_edges(open_edges, x, y, a, b, c, c0, c1, r0, r1, x0, y0, width)
        corners = a, b, c, twice
        count = _cut_up(
            place, owner, share, count, t, corners, x, y, nearness, near, front, shapes, c0, c1, r0, r1, x0, y0, width
        )  # fmt: skip
    return place[:count], owner[:count], share[:, :count], open_edges


@loop
def longer(values, more):
    result = np.empty(more, values.dtype)
    result[: len(values)] = values
    return result


@loop
def _longer_rows(values, more):
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
def _note_edges(open_edges, x, y, a, b, c, c0, c1, r0, r1, x0, y0, width):
    for row in range(r0, r1 + 1):
        for column in range(c0, c1 + 1):
            open_edges[(row - y0) * width + column - x0] += edges_in(x, y, a, b, c, (column, row, PIXEL))


@inner
def edges_in(x, y, a, b, c, at):
    """The sum over a triangle's edges that may cross the inside of a cell (its column, row and size as a shift). Of two
    triangles that share an edge, one
    adds what the other takes away, as both ask the same of the edge alone."""
    return _edge(x, y, a, b, at) + _edge(x, y, b, c, at) + _edge(x, y, c, a, at)


@inner
def _edge(x, y, a, b, at):
    column, row, shift = at
    left, top, side = column << shift, row << shift, 1 << shift
    apart = (max(x[a], x[b]) <= left) | (min(x[a], x[b]) >= left + side)
    apart |= (max(y[a], y[b]) <= top) | (min(y[a], y[b]) >= top + side)
    if apart:
        return np.int64(0)
    # By where the corners are, not by which they are: seams of a mesh are closed, too.
    one, other = (np.int64(y[a]) << 32) ^ x[a], (np.int64(y[b]) << 32) ^ x[b]
    return _first(one) * _second(other) - _first(other) * _second(one)


@inner
def _first(key):
    key = (key ^ (key >> 29)) * np.int64(_MIX)
    return key ^ (key >> 32)


@inner
def _second(key):
    key = (key ^ (key >> 31)) * np.int64(_OTHER)
    return key ^ (key >> 30)


@inner
def load_triangle(shapes, x, y, a, b, c, twice, column, row):
    """A triangle's corners, clockwise, from a pixel's top left corner, into the first scratch polygon; exact."""
    if twice < 0:
        b, c = c, b
    shapes[0, 0, 0], shapes[0, 0, 1] = _from(x[a], column), _from(y[a], row)
    shapes[0, 1, 0], shapes[0, 1, 1] = _from(x[b], column), _from(y[b], row)
    shapes[0, 2, 0], shapes[0, 2, 1] = _from(x[c], column), _from(y[c], row)


@inner
def _from(position, pixel):
    return (np.int64(position) - (pixel << PIXEL)) * (1.0 / GRID)


@inner
def _row_of(shapes, top, bottom, row):
    """The triangle in scratch 0 (rows `top` to `bottom`), cut to the row, counted from its own box. Returns where it
    is and how many corners it has."""
    source, count = 0, 3
    if row > top:
        count = halve(shapes, 0, 3, 1, float(row), 2, 1)[1]
        source = 1
    if row < bottom:
        count = halve(shapes, source, count, 1, row + 1.0, 2, 3)[0]
        source = 2
    return source, count


@inner
def halve(shapes, source, count, axis, level, low, high):
    """Cut a convex polygon into what lies below a level of x (axis 0) or y (1), to slot `low`, and what lies above, to
    slot `high`; their sizes."""
    lows, highs, beside = 0, 0, 1 - axis
    along, across = shapes[source, 0, axis] - level, shapes[source, 0, beside]
    for k in range(count):
        after = k + 1 if k + 1 < count else 0
        here, there = along, across
        along, across = shapes[source, after, axis] - level, shapes[source, after, beside]
        if here <= 0:
            shapes[low, lows, axis], shapes[low, lows, beside] = shapes[source, k, axis], there
            lows += 1
        if here >= 0:
            shapes[high, highs, axis], shapes[high, highs, beside] = shapes[source, k, axis], there
            highs += 1
        if here * along < 0:
            other = there + here / (here - along) * (across - there)
            shapes[low, lows, axis] = shapes[high, highs, axis] = level
            shapes[low, lows, beside] = shapes[high, highs, beside] = other
            lows, highs = lows + 1, highs + 1
    return lows, highs


@inner
def _full_run(shapes, slot, count, row):
    """First and last column (from a box's own left) of the pixels of a row that lie wholly inside its part."""
    left, right = -np.inf, np.inf
    for level in (float(row), row + 1.0):
        low, high = np.inf, -np.inf
        for k in range(count):
            if shapes[slot, k, 1] == level:
                low, high = min(low, shapes[slot, k, 0]), max(high, shapes[slot, k, 0])
        left, right = max(left, low), min(right, high)
    if left >= right:
        return np.int64(0), np.int64(-1)
    return np.int64(np.ceil(left)), np.int64(np.floor(right)) - 1


@inner
def _extent(shapes, slot, count):
    low = high = shapes[slot, 0, 0]
    for k in range(1, count):
        low, high = min(low, shapes[slot, k, 0]), max(high, shapes[slot, k, 0])
    return low, high


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
def _fill_front(front, x, y, nearness, corner, candidates, shapes, x0, x1, y0, y1):
    """`front` from all triangles that fill pixels of the band."""
    index, areas, first, last, _ = candidates
    width = x1 - x0
    for k in range(len(index)):
        if (last[k] - first[k] < 2) | (last[k] < y0) | (first[k] >= y1):
            continue
        t, twice = index[k], areas[k]
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        left, right = touched(x[a], x[b], x[c], -(1 << 30), 1 << 30)
        if right - left < 2:
            continue
        top, bottom = touched(y[a], y[b], y[c], -(1 << 30), 1 << 30)
        load_triangle(shapes, x, y, a, b, c, twice, left, top)
        p0, across, down = slopes(x, y, nearness, a, b, c, twice)
        least = min(nearness[a], nearness[b], nearness[c])
        for row in range(max(first[k], y0), min(last[k], y1 - 1) + 1):
            source, count = _row_of(shapes, 0, bottom - top, row - top)
            begin, end = _full_run(shapes, source, count, row - top)
            below = (row << PIXEL) - np.int64(y[p0]) + (GRID if down < 0 else 0)
            start = nearness[p0] + below * down - _MARGIN
            for column in range(max(begin + left, x0), min(end + left, x1 - 1) + 1):
                beside = (column << PIXEL) - np.int64(x[p0]) + (GRID if across < 0 else 0)
                at = (row - y0) * width + column - x0
                front[at] = max(front[at], max(start + beside * across, least - _MARGIN))


@inner
def _cut_up(
    place, owner, share, count, t, corners, x, y, nearness, near, front, shapes, c0, c1, r0, r1, x0, y0, width
):  # fmt: skip
    """Add the pieces of a triangle in the pixels of its box; returns how many there are now."""
    a, b, c, twice = corners
    left, _ = touched(x[a], x[b], x[c], -(1 << 30), 1 << 30)
    top, bottom = touched(y[a], y[b], y[c], -(1 << 30), 1 << 30)
    load_triangle(shapes, x, y, a, b, c, twice, left, top)
    p0, across, down = slopes(x, y, nearness, a, b, c, twice)
    for row in range(r0, r1 + 1):
        source, size = _row_of(shapes, 0, bottom - top, row - top)
        if size < 3:
            continue
        low, high = _extent(shapes, source, size)
        begin = end = np.int64(-1)
        if high - low > 1:
            begin, end = _full_run(shapes, source, size, row - top)
        column, stop = max(np.int64(np.floor(low)) + left, c0), min(np.int64(np.ceil(high)) - 1 + left, c1)
        below = (row << PIXEL) - np.int64(y[p0]) + (GRID if down > 0 else 0)
        start = nearness[p0] + below * down + _MARGIN
        rest, hold = source, 1 if source != 1 else 2
        if low < column - left:
            size = halve(shapes, source, size, 0, float(column - left), 3, 4)[1]
            rest = 4
        while column <= stop:
            beside = (column << PIXEL) - np.int64(x[p0]) + (GRID if across > 0 else 0)
            at = (row - y0) * width + column - x0
            seen = min(near, start + beside * across) >= front[at]
            if (column - left >= begin) & (column - left <= end):
                if seen:
                    place[count], owner[count], share[0, count] = at, t, 1.0
                    share[1, count] = share[2, count] = 0.5
                    count += 1
                column += 1
                if (column - left > end) & (column <= stop):
                    into = 3 if rest == 4 else 4
                    size = halve(shapes, rest, size, 0, float(column - left), hold, into)[1]
                    rest = into
                continue
            part, parts = rest, size
            if column < stop or high > column - left + 1:
                into = 3 if rest == 4 else 4
                parts, size = halve(shapes, rest, size, 0, column - left + 1.0, hold, into)
                part, rest = hold, into
            if seen & (parts > 2):
                area, mx, my = moments(shapes, part, parts)
                if area > NOTHING:
                    place[count], owner[count], share[0, count] = at, t, area
                    share[1, count] = min(max(mx / area - (column - left), 0.0), 1.0)
                    share[2, count] = min(max(my / area - (row - top), 0.0), 1.0)
                    count += 1
            column += 1
    return count


@inner
def moments(shapes, slot, count):
    """Area and first moments of a convex polygon, clockwise on a screen with y down."""
    area = across = down = 0.0
    x0, y0 = shapes[slot, 0, 0], shapes[slot, 0, 1]
    for k in range(1, count - 1):
        x1, y1 = shapes[slot, k, 0] - x0, shapes[slot, k, 1] - y0
        x2, y2 = shapes[slot, k + 1, 0] - x0, shapes[slot, k + 1, 1] - y0
        twice = x1 * y2 - y1 * x2
        area += twice
        across += twice * (x1 + x2)
        down += twice * (y1 + y2)
    return area / 2, across / 6 + area / 2 * x0, down / 6 + area / 2 * y0


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
