"""What is seen of the pieces of a band, as loops for the CPU: pixel by pixel, crowded ones cell by cell."""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner, loop
from cloak_core.render.visibility.hiding_loops import NUMBERS, settle_cell, whole_piece
from cloak_core.render.visibility.overlap_loops import NOTHING, PIXEL, WHOLE
from cloak_core.render.visibility.polygon_loops import SLOT
from cloak_core.render.visibility.sheet_loops import edge_room, settle_plainly

MOST_PARTS = 1024
"""Convex parts of one piece in one cell beyond which the cell is cut into four."""
CROWD = 192
"""Pieces from which a pixel is cut into cells."""
_FINEST = PIXEL - 5
"""The smallest cells, 1/32 pixel wide: too many parts there, and the pixel is given up, that is, it is counted."""


@loop
def settle(triangles, owner, share, begin, open_edges, x0, y0, width):
    """What is seen of every piece of a band, in place: its share of the pixel (0: hidden) and the centroid of what is
    seen. Returns how many pixels had to be given up."""
    most, given_up = 64, 0
    room, scratch, pool = edge_room(most), _scratch(most), np.empty((MOST_PARTS, SLOT))
    for place in range(len(begin) - 1):
        start, count = begin[place], begin[place + 1] - begin[place]
        if count < 2:
            continue
        total = 0.0
        for i in range(start, start + count):
            total += share[0, i]
        if open_edges[place] == 0 and abs(total - 1) <= WHOLE:
            continue
        if count > most:
            most = 2 * count
            room, scratch = edge_room(most), _scratch(most)
        at, chosen = (x0 + place % width, y0 + place // width, PIXEL), scratch[0]
        for i in range(count):
            chosen[i] = owner[start + i]
        left, edges = settle_plainly(triangles, at, chosen, owner, share, start, count, room)
        if left and _settle_pixel(triangles, at, owner, share, start, left, scratch, pool, room, edges):
            given_up += 1
            _fit(share, start, count)
    return given_up


@inner
def _settle_pixel(triangles, at, owner, share, start, count, scratch, pool, room, edges):
    """Settle the pieces of one pixel, all at once, or if they are too many, cell by cell. Whether it is given up."""
    chosen, pieces, seen, masks = scratch[0], scratch[1], scratch[2], scratch[6]
    if count <= CROWD and settle_cell(triangles, at, chosen, count, pieces, masks, pool, seen, room, edges):
        for i in range(count):
            if seen[i, 0] >= 0:
                _write_back(share, start + i, seen[i, 0], seen[i, 1], seen[i, 2])
        return False
    lost = _settle_cells(triangles, at, owner, start, count, scratch, pool, room)
    sums = scratch[5]
    for i in range(count):
        _write_back(share, start + i, sums[i, 0], sums[i, 1], sums[i, 2])
    return lost


@inner
def _fit(share, start, count):
    """What is seen in a pixel that was given up, no more than the pixel."""
    total = 0.0
    for i in range(start, start + count):
        total += share[0, i]
    for i in range(start, start + count):
        share[0, i] /= max(total, 1.0)


@inner
def _settle_cells(triangles, at, owner, start, count, scratch, pool, room):
    """Area and moments of what is seen of a pixel's pieces to `sums`, in scratch: a cell is cut into four as long as it
    is crowded. Whether that did not help."""
    chosen, pieces, seen, lists, cells, sums, masks = scratch
    lost = False
    sums[:count] = 0.0
    for i in range(count):
        lists[i] = start + i
    cells[0, 0], cells[0, 1], cells[0, 2], cells[0, 3], cells[0, 4] = at[0], at[1], at[2], 0, count
    depth = 1
    while depth > 0:
        depth -= 1
        here, first, last = (cells[depth, 0], cells[depth, 1], cells[depth, 2]), cells[depth, 3], cells[depth, 4]
        found, fine = last - first, here[2] <= _FINEST or last + 4 * (last - first) > len(lists)
        enough = False
        if found <= CROWD or fine:
            for i in range(found):
                chosen[i] = owner[lists[first + i]]
            enough = settle_cell(triangles, here, chosen, found, pieces, masks, pool, seen, room, np.int64(-1))
        if not enough and not fine:
            depth = _into_four(triangles, owner, here, first, last, lists, cells, depth)
            continue
        lost |= not enough
        side = 1.0 / (1 << (at[2] - here[2]))
        across, down = here[0] * side - at[0], here[1] * side - at[1]
        for i in range(found):
            if seen[i, 0] < 0:
                whole_piece(pool, pieces, seen, i)
            k, area = lists[first + i] - start, seen[i, 0] * side * side
            sums[k, 0] += area
            sums[k, 1] += area * across + seen[i, 1] * side * side * side
            sums[k, 2] += area * down + seen[i, 2] * side * side * side
    return lost


@inner
def _into_four(triangles, owner, here, first, last, lists, cells, depth):
    """A cell's quarters, each with a list of its pieces, to the cells from `depth` on; how many there are then."""
    x, y, _, corner, _, _ = triangles
    end = last
    for k in range(4):
        into, quarter = end, (2 * here[0] + k % 2, 2 * here[1] + k // 2, here[2] - 1)
        for i in range(first, last):
            lists[end] = lists[i]
            end += _meets(x, y, corner, owner[lists[i]], quarter)
        cells[depth, 0], cells[depth, 1], cells[depth, 2] = quarter
        cells[depth, 3], cells[depth, 4] = into, end
        depth += into < end
    return depth


@inner
def _meets(x, y, corner, t, at):
    """Whether the box of a triangle reaches into a cell."""
    a, b, c = corner[0, t], corner[1, t], corner[2, t]
    left, top, side = at[0] << at[2], at[1] << at[2], 1 << at[2]
    across = (max(x[a], x[b], x[c]) > left) & (min(x[a], x[b], x[c]) < left + side)
    return across & (max(y[a], y[b], y[c]) > top) & (min(y[a], y[b], y[c]) < top + side)


@loop
def _scratch(count):
    """For so many pieces of a pixel: triangles, numbers, what is seen of them, lists, cells, sums of cells,
    fields and a list."""
    chosen, pieces, lists, cells = (
        np.empty(count, np.int64),
        np.empty((count, NUMBERS)),
        np.empty(16 * count, np.int64),
        np.empty((64, 5), np.int64),
    )
    return chosen, pieces, np.empty((count, 3)), lists, cells, np.empty((count, 3)), np.empty((2, count), np.int64)


@inner
def _write_back(share, at, area, across, down):
    share[0, at] = area if area > NOTHING else 0.0
    share[1, at] = min(max(across / area, 0.0), 1.0) if area > 0 else 0.0
    share[2, at] = min(max(down / area, 0.0), 1.0) if area > 0 else 0.0
