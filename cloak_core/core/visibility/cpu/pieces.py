"""The pieces of triangles in pixels, as numba loops.

A piece is the overlap of a triangle with a pixel; its place is a flat index into the pixels of a band, rows of the
window. Areas and moments come from edges alone (signed_area.py). What lies behind a surface that fills the pixel is
dropped before it is stored (early occlusion culling, by bounds of depth in pixels); triangles that face the camera come
first, so that most others are dropped.
"""

from __future__ import annotations

import numpy as np

from cloak_core.core.visibility.compiled import inner, loop
from cloak_core.core.visibility.cpu.edge_hash import WHOLE, edge_sum
from cloak_core.core.visibility.cpu.signed_area import prepare_edges, walk_row
from cloak_core.core.visibility.cpu.triangles import PIXEL, doubled_area, slopes, touched
from cloak_core.core.visibility.cpu.workspace import Pixels
from cloak_core.core.visibility.screen import GRID

NOTHING = 1e-9
"""Share of a pixel below which a piece is dropped."""
MARGIN = 2.0**-36
"""Inverse depth by which a piece must lie behind to be dropped; depths themselves are told apart by 2^-42."""
_FAR = 1 << 30


@inner
def row_bounds(mesh, plane, row):
    """Compute the greatest and least inverse depth of a plane in a row of pixels, at the x of its first corner."""
    p0, _, down = plane
    top = mesh.inverse_depth[p0] + ((row << PIXEL) - np.int64(mesh.y[p0])) * down
    return top + max(down * GRID, 0.0), top + min(down * GRID, 0.0)


@inner
def pixel_bounds(level, plane, x, column, near, far):
    """Compute the greatest and least inverse depth that a triangle may have in a pixel."""
    high, low = level
    p0, across, _ = plane
    left = ((column << PIXEL) - np.int64(x[p0])) * across
    return min(near, high + left + max(across * GRID, 0.0)), max(far, low + left + min(across * GRID, 0.0))


@inner
def close_front(pixels):
    """Raise `front` to the pieces that fill a pixel together."""
    for at in range(len(pixels.front)):
        if (pixels.edge_sum[at] == 0) & (abs(pixels.total[at] - 1) <= WHOLE):
            pixels.front[at] = max(pixels.front[at], pixels.least[at] - MARGIN)


@inner
def fill_front(front, mesh, candidates, x0, x1, y0, y1):
    """Raise `front` to the triangles that fill pixels of the band."""
    index, areas, first, last, _ = candidates
    for k in range(len(index)):
        # What touches fewer than three rows or columns hardly ever fills a pixel by itself.
        if (last[k] - first[k] < 2) | (last[k] < y0) | (first[k] >= y1):
            continue
        t = index[k]
        a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
        left, right = touched(mesh.x[a], mesh.x[b], mesh.x[c], -_FAR, _FAR)
        if right - left < 2:
            continue
        plane = slopes(mesh.x, mesh.y, mesh.inverse_depth, a, b, c, areas[k])
        far = min(mesh.inverse_depth[a], mesh.inverse_depth[b], mesh.inverse_depth[c])
        for row in range(max(first[k], y0), min(last[k], y1 - 1) + 1):
            above, below = _span(mesh, a, b, c, row << PIXEL), _span(mesh, a, b, c, (row + 1) << PIXEL)
            # A triangle is convex: columns within it at the top and the bottom of a row are filled. 1e-6 pixels are
            # more than the rounding of both ends.
            begin = np.int64(np.ceil(max(above[0], below[0]) + 1e-6))
            end = np.int64(np.floor(min(above[1], below[1]) - 1e-6)) - 1
            if begin > end:
                continue
            level = row_bounds(mesh, plane, row)
            for column in range(max(begin, x0), min(end, x1 - 1) + 1):
                low = pixel_bounds(level, plane, mesh.x, column, 2.0, far)[1]  # 2: no depth is greater than 1
                at = (row - y0) * (x1 - x0) + column - x0
                front[at] = max(front[at], low - MARGIN)


@inner
def _span(mesh, a, b, c, level):
    """Find a triangle's extent at a level of y (grid units), from .. to in pixels; inf .. -inf where there is none."""
    x, y = mesh.x, mesh.y
    low, high = np.inf, -np.inf
    for k in range(3):
        p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        if (min(y[p], y[q]) <= level) & (max(y[p], y[q]) >= level) & (y[p] != y[q]):
            at = (x[p] + (level - np.int64(y[p])) / (np.int64(y[q]) - y[p]) * (np.int64(x[q]) - x[p])) / GRID
            low, high = min(low, at), max(high, at)
    return low, high


@loop
def find_candidates(x, y, corner, one_sided, x0, x1, y0, y1):
    """List triangles that touch the window and have area: first front-facing, then back-facing ones.

    x, y: int32 [K], snapped; corner: int64 [3, N]; one_sided: bool [N], dropped where the back shows; x0, x1, y0, y1:
    the window, pixels. Returns index and doubled area, first and last row; and for every row of the window how many
    pixels at most they touch there.
    """
    most = corner.shape[1]
    count, backs = 0, 0
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
        # Fronts fill the arrays from their beginning, backs from their end: one pass, and both keep their order.
        at = count if twice < 0 else most - 1 - backs
        count, backs = count + (twice < 0), backs + (twice > 0)
        index[at], area[at], first[at], last[at] = t, twice, r0, r1
        load[r0 - y0] += c1 - c0 + 1
        load[r1 + 1 - y0] -= c1 - c0 + 1
    # Each triangle added its width at its first row and took it off after its last: running sums give every row's.
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

    mesh: a `Mesh`; candidates: what `find_candidates` returns; x0, x1, y0, y1: the band, pixels; most: pieces there may
    be. Returns int32 [n], int32 [n] and float32 [3, n]; and the edge sum of each pixel, int64 [pixels] (edge_hash.py).
    """
    index, areas, first, last, _ = candidates
    width = x1 - x0
    count = 0
    backs = False
    places = width * (y1 - y0)
    pixels = Pixels(np.zeros(places, np.int64), np.zeros(places), np.zeros(places), np.full(places, 2.0))
    pieces = np.empty(most, np.int32), np.empty(most, np.int32), np.empty((3, most), np.float32)
    edges, signs, sums = np.empty((3, 6)), np.empty(3, np.int64), np.zeros((width + 1, 5))
    fill_front(pixels.front, mesh, candidates, x0, x1, y0, y1)
    for k in range(len(index)):
        # Before the first back-facing triangle: closed fronts hide most of what follows.
        if (areas[k] > 0) & (not backs):
            backs = True
            close_front(pixels)
        if (last[k] < y0) | (first[k] >= y1):
            continue
        t = index[k]
        rows = (max(first[k], y0), min(last[k], y1 - 1))
        a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
        columns = touched(mesh.x[a], mesh.x[b], mesh.x[c], x0, x1)
        # Small triangles are the most frequent ones, and need no edges: their piece is the triangle itself.
        if (columns[0] == columns[1]) & (rows[0] == rows[1]) & _within(mesh, a, b, c, columns[0], rows[0]):
            at = (rows[0] - y0) * width + columns[0] - x0
            count = _add_inner(pieces, count, mesh, t, areas[k], columns[0], rows[0], pixels, at)
        else:
            prepare_edges(edges, signs, mesh, (a, b, c), areas[k])
            window = columns, rows, (x0, x1, y0)
            count = _add_rows(pieces, count, mesh, t, areas[k], edges, signs, sums, pixels, window)
    return pieces[0][:count], pieces[1][:count], pieces[2][:, :count], pixels.edge_sum


@inner
def _add_inner(pieces, count, mesh, t, twice, column, row, pixels, at):
    """Add the piece of a triangle that lies within one pixel; returns how many there are now.

    pieces: place, triangle, area and centroid, of which the first `count` are written; t: the triangle; twice: its
    doubled signed area, grid units squared; at: the pixel's place in the band.
    """
    place, owner, coverage = pieces
    x, y, depth = mesh.x, mesh.y, mesh.inverse_depth
    a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
    pixels.edge_sum[at] += edge_sum(x, y, mesh.hashes, a, b, c, twice, (column, row, PIXEL))
    size = abs(twice) * (0.5 / (GRID * GRID))
    # Behind a surface that fills the pixel a piece is never seen; `MARGIN` covers the rounding of both depths.
    if (size > NOTHING) & (max(depth[a], depth[b], depth[c]) + MARGIN >= pixels.front[at]):
        pixels.total[at] += size
        pixels.least[at] = min(pixels.least[at], min(depth[a], depth[b], depth[c]))
        place[count], owner[count], coverage[0, count] = at, t, size
        coverage[1, count], coverage[2, count] = _middle(x[a], x[b], x[c], column), _middle(y[a], y[b], y[c], row)
        count += 1
    return count


@inner
def _add_rows(pieces, count, mesh, t, twice, edges, signs, sums, pixels, window):
    """Add the pieces of a triangle, row by row of pixels; returns how many there are now.

    edges [3, 6], signs [3]: see `prepare_edges`; sums [width + 1, 5]: zeros, and left so; window: first and last column
    and row of the triangle, and the band's left, right and top.
    """
    (c0, c1), (r0, r1), (x0, x1, y0) = window
    a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
    depth = mesh.inverse_depth
    near, far = max(depth[a], depth[b], depth[c]), min(depth[a], depth[b], depth[c])
    # Small triangles do not need their plane: the depths of their corners are bounds enough.
    small = (c1 - c0 < 3) & (r1 - r0 < 3)
    plane = (a, 0.0, 0.0) if small else slopes(mesh.x, mesh.y, depth, a, b, c, twice)
    for row in range(r0, r1 + 1):
        level = (near, far) if small else row_bounds(mesh, plane, row)
        base = (row - y0) * (x1 - x0)
        spanned = walk_row(edges, signs, sums, pixels.edge_sum, row, x0, x1, base)
        bounds = level, plane, mesh.x, near, far
        count = _add_row(pieces, count, t, spanned, sums, pixels, bounds, (c0, c1, x0, base))
    return count


@inner
def _add_row(pieces, count, t, spanned, sums, pixels, bounds, window):
    """Add the pieces of a triangle in a row of pixels, from the accumulated edges; returns how many there are now.

    spanned: what `walk_row` returns; bounds: the row's depths, the plane, x of the corners, nearest and farthest depth
    of the triangle; window: its first and last column, the band's left, and the place of the row's first pixel.
    """
    place, owner, coverage = pieces
    begin, end, carry, moment = spanned
    level, plane, x, near, far = bounds
    c0, c1, x0, base = window
    for column in range(max(begin, c0), max(c1, end) + 1):
        # Signed-area accumulation: what entered further left lies right of its edges in this whole pixel (carry, whose
        # centroid is in the pixel's middle across), what enters here in a part of it (sums).
        own, at = column - x0, base + column - x0
        area, mx, my = sums[own, 0] + carry, sums[own, 1] + carry / 2, sums[own, 2] + moment
        carry, moment = carry + sums[own, 3], moment + sums[own, 4]
        if column <= end:
            sums[own, 0] = sums[own, 1] = sums[own, 2] = sums[own, 3] = sums[own, 4] = 0.0
        elif area < NOTHING:  # right of the last edge, and nothing is carried on: the triangle ends here
            break
        high, low = pixel_bounds(level, plane, x, column, near, far)
        if (area > NOTHING) & (high + MARGIN >= pixels.front[at]):
            pixels.total[at] += area
            pixels.least[at] = min(pixels.least[at], low)
            place[count], owner[count], coverage[0, count] = at, t, area
            coverage[1, count], coverage[2, count] = min(max(mx / area, 0.0), 1.0), min(max(my / area, 0.0), 1.0)
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
def sort_by_pixel(place, owner, coverage, places):
    """Sort pieces by place (counting sort, stable); also return where each place's begin, int64 [places + 1].

    place, owner: int32 [n]; coverage: float32 [3, n].
    """
    begin = np.zeros(places + 1, np.int64)
    for p in place:
        begin[p + 1] += 1
    for p in range(places):
        begin[p + 1] += begin[p]
    following = begin[:-1].copy()  # of each place, where its next piece goes
    sorted_owner, sorted_coverage = np.empty_like(owner), np.empty_like(coverage)
    for i in range(len(place)):
        at = following[place[i]]
        following[place[i]] = at + 1
        sorted_owner[at] = owner[i]
        for k in range(3):
            sorted_coverage[k, at] = coverage[k, i]
    return sorted_owner, sorted_coverage, begin
