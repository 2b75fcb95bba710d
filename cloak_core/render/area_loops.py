"""Fragments by exact area, as loops for the CPU; area.py and competition.py say what is done and why.

Places are flat indices into the window's pixels; pieces are overlaps of a triangle with a pixel.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import loop
from cloak_core.render.covering import DEPTH_BITS, ID_BITS
from cloak_core.render.covering_loops import EMPTY, cover_box, doubled_area, in_order, span
from cloak_core.render.projection import GRID

SIDE = 16
"""Samples along the side of a doubtful pixel."""
WHOLE = 1e-6
"""Areas that add up to 1 within this leave neither gap nor overlap; rounding stays below 1e-9."""
NOTHING = 1e-9
"""Share of a pixel below which a piece is dropped."""
_TINY = 1e-30
_PIXEL = GRID.bit_length() - 1
_SAMPLE = (GRID // SIDE).bit_length() - 1
_ID = (1 << ID_BITS) - 1


@loop
def fragments(x, y, nearness, corner, ids, cull, x0, x1, y0, y1, image_width, focal):
    """Fragments of one view in a window of the image, as `emit` gives them. x, y: snapped, int32 [K]; nearness [K];
    corner: int64 [3, N]; ids: int64 [N]; cull: whether clockwise triangles are dropped; focal: pixels."""
    width = x1 - x0
    place, owner, area = find_pieces(x, y, corner, cull, x0, x1, y0, y1)
    owner, area, begin = by_place(place, owner, area, width * (y1 - y0))
    compete(x, y, nearness, corner, owner, area, begin, x0, y0, width, focal)
    return emit(x, y, corner, ids, owner, area, begin, x0, y0, width, image_width)


@loop
def find_pieces(x, y, corner, cull, x0, x1, y0, y1):
    """Every overlap of triangles with pixels of the window: place, triangle (its index) and area, by triangle."""
    capacity = 2 * corner.shape[1] + 1024
    place, owner, area = np.empty(capacity, np.int32), np.empty(capacity, np.int32), np.empty(capacity)
    count, width = 0, x1 - x0
    edges = np.empty((3, 4))
    for t in range(corner.shape[1]):
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        left, right = np.int64(min(x[a], x[b], x[c])), np.int64(max(x[a], x[b], x[c]))
        top, bottom = np.int64(min(y[a], y[b], y[c])), np.int64(max(y[a], y[b], y[c]))
        c0, c1 = max(left >> _PIXEL, x0), min((right - 1) >> _PIXEL, x1 - 1)
        r0, r1 = max(top >> _PIXEL, y0), min((bottom - 1) >> _PIXEL, y1 - 1)
        if (c0 > c1) | (r0 > r1):
            continue
        twice = doubled_area(x, y, a, b, c)
        if twice == 0 or (cull and twice > 0):
            continue
        if count + (c1 - c0 + 1) * (r1 - r0 + 1) > len(place):
            more = len(place) + (c1 - c0 + 1) * (r1 - r0 + 1)
            place, owner, area = _longer(place, more), _longer(owner, more), _longer(area, more)
        if (left >> _PIXEL == (right - 1) >> _PIXEL) & (top >> _PIXEL == (bottom - 1) >> _PIXEL):  # within one pixel
            size = abs(twice) * (0.5 / (GRID * GRID))
            if size > NOTHING:
                place[count], owner[count], area[count] = (r0 - y0) * width + c0 - x0, t, size
                count += 1
            continue
        for row in range(r0, r1 + 1):
            whole = _edges_in_row(x, y, a, b, c, c0, row, edges)
            before = _left_of(edges, whole, 0.0) if left >> _PIXEL < c0 else 0.0
            for column in range(c0, c1 + 1):
                upto = _left_of(edges, whole, column - c0 + 1.0)
                size = abs(upto - before)
                before = upto
                if size > NOTHING:
                    place[count], owner[count], area[count] = (row - y0) * width + column - x0, t, size
                    count += 1
    return place[:count], owner[:count], area[:count]


@loop
def _longer(values, more):
    """At least twice as long, at least by so much."""
    result = np.empty(2 * len(values) + more, values.dtype)
    result[: len(values)] = values
    return result


@loop
def _edges_in_row(x, y, a, b, c, column, row, edges):
    """Every edge within a row of pixels, x from the column on: its greatest x, the span of its x, its height and that
    over twice the span. Returns the integral of x dy over all of them."""
    whole = 0.0
    for k in range(3):
        i, j = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        xi, yi = _from(x[i], column), _from(y[i], row)
        xj, yj = _from(x[j], column), _from(y[j], row)
        inner_i, inner_j = min(max(yi, 0.0), 1.0), min(max(yj, 0.0), 1.0)
        lean = (xj - xi) / (yj - yi) if yj != yi else xj - xi
        start, stop = (inner_i - yi) * lean + xi, (inner_j - yi) * lean + xi
        rise, high = inner_j - inner_i, max(start, stop)
        reach = high - min(start, stop)
        whole += (start + stop) * rise
        edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3] = high, reach, rise, rise / max(reach * 2, _TINY)
    return whole * 0.5


@loop
def _from(position, pixel):
    return (np.int64(position) - (pixel << _PIXEL)) * (1.0 / GRID)


@loop
def _left_of(edges, whole, c):
    """Area of a triangle's part in its row that lies to the left of x = c, negative where it turns the other way."""
    area = whole
    for k in range(3):
        reach = max(edges[k, 0] - c, 0.0)
        within = min(reach, edges[k, 1])
        area -= (reach - within) * edges[k, 2] + within * within * edges[k, 3]
    return area


@loop
def by_place(place, owner, area, places):
    """The pieces in order of place, those of one place as they came; and where each place's begin, [places + 1]."""
    begin = np.zeros(places + 1, np.int64)
    for p in place:
        begin[p + 1] += 1
    for p in range(places):
        begin[p + 1] += begin[p]
    following = begin[:-1].copy()
    sorted_owner, sorted_area = np.empty_like(owner), np.empty_like(area)
    for i in range(len(place)):
        at = following[place[i]]
        following[place[i]] = at + 1
        sorted_owner[at], sorted_area[at] = owner[i], area[i]
    return sorted_owner, sorted_area, begin


@loop
def compete(x, y, nearness, corner, owner, area, begin, x0, y0, width, focal):
    """Scale every piece's area by the share of it that is seen."""
    keys = np.empty((SIDE, SIDE), np.int64)
    held, won = np.empty(64, np.int64), np.empty(64, np.int64)
    for place in range(len(begin) - 1):
        start, stop = begin[place], begin[place + 1]
        total = 0.0
        for i in range(start, stop):
            total += area[i]
        if start == stop or abs(total - 1) <= WHOLE:
            continue
        if stop - start > len(held):
            held, won = np.empty(2 * (stop - start), np.int64), np.empty(2 * (stop - start), np.int64)
        if total >= 1 - WHOLE and _front_layer(nearness, corner, owner[start:stop], area[start:stop]):
            continue
        column, row = x0 + place % width, y0 + place // width
        full = _cover_pixel(x, y, nearness, corner, owner[start:stop], column, row, keys, held, won)
        sums = 0.0
        for i in range(start, stop):
            if held[i - start]:
                seen = won[i - start] / held[i - start]
            else:
                near = _near_enough(x, y, nearness, corner, owner[i], column, row, keys, focal)
                seen = 1.0 if near else 0.0
            area[i] *= seen
            sums += area[i]
        # Shares fill a pixel at most once, and just once where it is full.
        sums = max(sums, NOTHING if full and total >= 1 else 1.0)
        for i in range(start, stop):
            area[i] /= sums


@loop
def _front_layer(nearness, corner, owner, area):
    """Whether the nearest pieces add up to the pixel and lie wholly before all others; if so, those lose their area."""
    near, far = np.empty(len(owner)), np.empty(len(owner))
    for i in range(len(owner)):
        a, b, c = nearness[corner[0, owner[i]]], nearness[corner[1, owner[i]]], nearness[corner[2, owner[i]]]
        near[i], far[i] = max(a, b, c), min(a, b, c)
    order = np.argsort(-near, kind="mergesort")
    total, back, count = 0.0, np.inf, 0
    while count < len(order) and total < 1 - WHOLE:
        total += area[order[count]]
        back = min(back, far[order[count]])
        count += 1
    if abs(total - 1) > WHOLE or (count < len(order) and near[order[count]] >= back):
        return False
    area[order[count:]] = 0
    return True


@loop
def _cover_pixel(x, y, nearness, corner, owner, column, row, keys, held, won):
    """What is in front at each sample of a pixel; how many samples each triangle holds, and in how many it is in front.
    Returns whether something is at every sample."""
    keys[:] = EMPTY
    left, top = column * SIDE, row * SIDE
    for i in range(len(owner)):
        t = owner[i]
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        c0, c1 = span(x[a], x[b], x[c], _SAMPLE, left, left + SIDE - 1)
        r0, r1 = span(y[a], y[b], y[c], _SAMPLE, top, top + SIDE - 1)
        held[i] = won[i] = 0
        if (c0 <= c1) & (r0 <= r1):
            order = in_order(x, y, a, b, c, doubled_area(x, y, a, b, c))
            held[i] = cover_box(keys, x, y, nearness, order, i, r0, r1, c0, c1, top, left, _SAMPLE)
    full = True
    for key in keys.flat:
        if key == EMPTY:
            full = False
        else:
            won[key & _ID] += 1
    return full


@loop
def _near_enough(x, y, nearness, corner, t, column, row, keys, focal):
    """Whether a triangle that holds no sample of a pixel is seen: judged where it lies, against the sample next to it.

    It is seen unless what is seen there is nearer than its own plane by more than the size of a pixel.
    """
    a, b, c = corner[0, t], corner[1, t], corner[2, t]
    xa, xb, xc = x[a] / GRID, x[b] / GRID, x[c] / GRID
    ya, yb, yc = y[a] / GRID, y[b] / GRID, y[c] / GRID
    across, down = _sample(xa, xb, xc, column), _sample(ya, yb, yc, row)
    at_x, at_y = (across + 0.5) / SIDE + column, (down + 0.5) / SIDE + row
    na, nb, nc = nearness[a], nearness[b], nearness[c]
    twice = (xb - xa) * (yc - ya) - (yb - ya) * (xc - xa)
    w1 = ((yc - ya) * (at_x - xa) - (xc - xa) * (at_y - ya)) / twice
    w2 = ((xb - xa) * (at_y - ya) - (yb - ya) * (at_x - xa)) / twice
    own = min(max(w1 * (nb - na) + w2 * (nc - na) + na, min(na, nb, nc)), max(na, nb, nc))
    seen = ((1 << DEPTH_BITS) - 1 - (keys[down, across] >> ID_BITS)) / (1 << DEPTH_BITS)
    return own >= seen * (1 - 1 / focal)


@loop
def _sample(a, b, c, pixel):
    """The sample next to the middle of the part of a triangle's extent that lies in the pixel."""
    middle = (max(min(a, b, c), pixel) + min(max(a, b, c), pixel + 1)) / 2
    return np.int64(min(max(np.floor((middle - pixel) * SIDE), 0), SIDE - 1))


@loop
def emit(x, y, corner, ids, owner, area, begin, x0, y0, width, image_width):
    """What is left of the pieces as fragments: pixel, triangle, area, their triangles' middles, and from there to where
    each is lit.

    Along an axis, as a triangle's middle lies in the middle third of its extent, its piece's is taken to be the nearest
    place in the middle third of what the pixel holds of that extent.
    """
    most = len(owner)
    pixel, triangle, share = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.float32)
    center, offset = np.empty((2, most)), np.empty((2, most), np.float32)
    count = 0
    for place in range(len(begin) - 1):
        column, row = x0 + place % width, y0 + place // width
        for i in range(begin[place], begin[place + 1]):
            if area[i] <= NOTHING:
                continue
            t = owner[i]
            a, b, c = corner[0, t], corner[1, t], corner[2, t]
            pixel[count], triangle[count], share[count] = row * image_width + column, ids[t], area[i]
            center[0, count], offset[0, count] = _lit_at(x[a] / GRID, x[b] / GRID, x[c] / GRID, column)
            center[1, count], offset[1, count] = _lit_at(y[a] / GRID, y[b] / GRID, y[c] / GRID, row)
            count += 1
    return pixel[:count], triangle[:count], share[:count], center[:, :count], offset[:, :count]


@loop
def _lit_at(a, b, c, pixel):
    center = (a + b + c) / 3
    low, high = max(min(a, b, c), pixel), min(max(a, b, c), pixel + 1)
    third = (high - low) / 3
    return center, min(max(center, low + third), high - third) - center
