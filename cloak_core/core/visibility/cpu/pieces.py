"""The pieces of triangles in pixels, as numba loops.

A piece is the overlap of a triangle with a pixel; its place is a flat index into the pixels of a band, rows of the
window. Areas and moments come from edges alone (signed_area.py). What lies behind a surface that fills the pixel is
dropped before it is stored (front.py); triangles that face the camera come first, so that most others are dropped.
"""

from __future__ import annotations

import numpy as np

from cloak_core.core.visibility.compiled import inner, loop
from cloak_core.core.visibility.cpu.edge_hash import edge_sum
from cloak_core.core.visibility.cpu.front import MARGIN, close_front, fill_front, pixel_bounds, row_bounds
from cloak_core.core.visibility.cpu.signed_area import prepare_edges, walk_row
from cloak_core.core.visibility.cpu.triangles import PIXEL, doubled_area, slopes, touched
from cloak_core.core.visibility.cpu.workspace import Pixels
from cloak_core.core.visibility.screen import GRID

NOTHING = 1e-9
"""Share of a pixel below which a piece is dropped."""


@loop
def find_candidates(x, y, corner, one_sided, x0, x1, y0, y1):
    """List triangles that touch the window and have area: first front-facing, then back-facing ones.

    Returns index and doubled area, first and last row; and for every row of the window how many pixels at most they
    touch there.
    """
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
    """Concatenate the first counts[0] values and the last counts[1], reversed."""
    return np.concatenate((values[: counts[0]], values[len(values) - counts[1] :][::-1]))


@loop
def find_pieces(mesh, candidates, x0, x1, y0, y1, most):
    """Find all pieces of a band: place, triangle (its index), area and centroid within the pixel [3, n].

    Also returns the edge sum of each pixel (edge_hash.py). most: pieces there may be.
    """
    index, areas, first, last, _ = candidates
    width, count, backs = x1 - x0, 0, False
    places = width * (y1 - y0)
    pixels = Pixels(np.zeros(places, np.int64), np.zeros(places), np.zeros(places), np.full(places, 2.0))
    found = np.empty(most, np.int32), np.empty(most, np.int32), np.empty((3, most), np.float32)
    edges, signs, sums = np.empty((3, 6)), np.empty(3, np.int64), np.zeros((width + 1, 5))
    fill_front(pixels.front, mesh, candidates, x0, x1, y0, y1)
    for k in range(len(index)):
        if (areas[k] > 0) & (not backs):
            backs = True
            close_front(pixels)
        if (last[k] < y0) | (first[k] >= y1):
            continue
        t, rows = index[k], (max(first[k], y0), min(last[k], y1 - 1))
        a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
        columns = touched(mesh.x[a], mesh.x[b], mesh.x[c], x0, x1)
        if (columns[0] == columns[1]) & (rows[0] == rows[1]) & _within(mesh, a, b, c, columns[0], rows[0]):
            at = (rows[0] - y0) * width + columns[0] - x0
            count = _add_inner(found, count, mesh, t, areas[k], columns[0], rows[0], pixels, at)
        else:
            prepare_edges(edges, signs, mesh, (a, b, c), areas[k])
            window = columns, rows, (x0, x1, y0)
            count = _add_rows(found, count, mesh, t, areas[k], edges, signs, sums, pixels, window)
    return found[0][:count], found[1][:count], found[2][:, :count], pixels.edge_sum


@inner
def _add_inner(found, count, mesh, t, twice, column, row, pixels, at):
    """Add the piece of a triangle that lies within one pixel; returns how many there are now."""
    place, owner, share = found
    x, y, depth = mesh.x, mesh.y, mesh.inverse_depth
    a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
    pixels.edge_sum[at] += edge_sum(x, y, mesh.hashes, a, b, c, twice, (column, row, PIXEL))
    size = abs(twice) * (0.5 / (GRID * GRID))
    if (size > NOTHING) & (max(depth[a], depth[b], depth[c]) + MARGIN >= pixels.front[at]):
        pixels.total[at] += size
        pixels.least[at] = min(pixels.least[at], min(depth[a], depth[b], depth[c]))
        place[count], owner[count], share[0, count] = at, t, size
        share[1, count], share[2, count] = _middle(x[a], x[b], x[c], column), _middle(y[a], y[b], y[c], row)
        count += 1
    return count


@inner
def _add_rows(found, count, mesh, t, twice, edges, signs, sums, pixels, window):
    """Add the pieces of a triangle, row by row of pixels; returns how many there are now."""
    (c0, c1), (r0, r1), (x0, x1, y0) = window
    a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
    depth = mesh.inverse_depth
    near, far = max(depth[a], depth[b], depth[c]), min(depth[a], depth[b], depth[c])
    # Small triangles do not need their plane: the depths of their corners are bounds enough.
    small = (c1 - c0 < 3) & (r1 - r0 < 3)
    plane = (a, 0.0, 0.0) if small else slopes(mesh.x, mesh.y, depth, a, b, c, twice)
    for row in range(r0, r1 + 1):
        level, base = (near, far) if small else row_bounds(mesh, plane, row), (row - y0) * (x1 - x0)
        spanned = walk_row(edges, signs, sums, pixels.edge_sum, row, x0, x1, base)
        bounds = level, plane, mesh.x, near, far
        count = _add_row(found, count, t, spanned, sums, pixels, bounds, (c0, c1, x0, base))
    return count


@inner
def _add_row(found, count, t, spanned, sums, pixels, bounds, window):
    """Add the pieces of a triangle in a row of pixels, from the accumulated edges; returns how many there are now."""
    place, owner, share = found
    begin, end, carry, moment = spanned
    level, plane, x, near, far = bounds
    c0, c1, x0, base = window
    for column in range(max(begin, c0), max(c1, end) + 1):
        own, at = column - x0, base + column - x0
        area, mx, my = sums[own, 0] + carry, sums[own, 1] + carry / 2, sums[own, 2] + moment
        carry, moment = carry + sums[own, 3], moment + sums[own, 4]
        if column <= end:
            sums[own, 0] = sums[own, 1] = sums[own, 2] = sums[own, 3] = sums[own, 4] = 0.0
        elif area < NOTHING:
            break
        high, low = pixel_bounds(level, plane, x, column, near, far)
        if (area > NOTHING) & (high + MARGIN >= pixels.front[at]):
            pixels.total[at] += area
            pixels.least[at] = min(pixels.least[at], low)
            place[count], owner[count], share[0, count] = at, t, area
            share[1, count], share[2, count] = min(max(mx / area, 0.0), 1.0), min(max(my / area, 0.0), 1.0)
            count += 1
    return count


@inner
def _within(mesh, a, b, c, column, row):
    """Test whether a triangle lies within one pixel."""
    return _in_cell(mesh.x[a], mesh.x[b], mesh.x[c], column) & _in_cell(mesh.y[a], mesh.y[b], mesh.y[c], row)


@inner
def _in_cell(a, b, c, cell):
    return (np.int64(min(a, b, c)) >= cell << PIXEL) & (np.int64(max(a, b, c)) <= (cell + 1) << PIXEL)


@inner
def _middle(a, b, c, pixel):
    return ((np.int64(a) + b + c) - 3 * (pixel << PIXEL)) * (1 / (3 * GRID))


@loop
def sort_by_pixel(place, owner, share, places):
    """Counting sort of the pieces by place, stable; also returns where each place's begin [places + 1]."""
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
