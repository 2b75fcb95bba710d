"""What is seen of the pieces of a band, as loops for the CPU: pixel by pixel, crowded ones cell by cell."""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner, loop
from cloak_core.render.visibility.cell_loops import at_a_glance, settle_cell
from cloak_core.render.visibility.edge_loops import SEGMENT
from cloak_core.render.visibility.overlap_loops import NOTHING, PIXEL, WHOLE
from cloak_core.render.visibility.plane_loops import AREA, NUMBERS, polygon
from cloak_core.render.visibility.polygon_loops import SIZE, SLOT, hold, measure

MOST_PARTS = 4096
"""Slots for the parts of one cell beyond which it is given up: it keeps what it has, and is counted."""
CROWD = 96
"""Pieces from which a pixel is cut into cells."""
_FINEST = PIXEL - 5


@loop
def settle(x, y, nearness, corner, ids, owner, share, begin, open_edges, x0, y0, width):
    """What is seen of every piece of a band, in place: its share of the pixel (0: hidden) and the centroid of what is
    seen. Returns how many pixels had to be given up."""
    triangles, most, given_up = (x, y, nearness, corner, ids), 64, 0
    room, scratch = _room(most, 512), _scratch(most)
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
            room, scratch = _room(most, 8 * most), _scratch(most)
        at, (pieces, chosen, _, _, _) = (x0 + place % width, y0 + place // width, PIXEL), scratch
        for i in range(count):
            chosen[i], pieces[i, AREA] = owner[start + i], share[0, start + i]
        plain, edges = at_a_glance(triangles, at, chosen, count, pieces, room)
        if plain:
            for i in range(count):
                share[0, start + i] = pieces[i, AREA]
            continue
        enough = _settle_pixel(triangles, at, owner[start : start + count], scratch, room, edges)
        while not enough and len(room[0]) < MOST_PARTS:
            room = _room(most, 4 * len(room[0]))
            enough = _settle_pixel(triangles, at, owner[start : start + count], scratch, room, np.int64(-1))
        given_up += not enough
        _write_back(share, start, scratch[2], count)
    return given_up


@inner
def _settle_pixel(triangles, at, owner, scratch, room, edges):
    """Area and moments of what is seen of a pixel's pieces to `seen` in scratch, cell by cell, each cut into four as
    long as it is crowded. Whether the room did. edges: open ones of the pixel if they are known, or -1."""
    pieces, chosen, seen, lists, cells = scratch
    sums, count, enough = room[6], len(owner), True
    seen[:count] = 0.0
    for i in range(count):
        lists[i] = i
    cells[0, 0], cells[0, 1], cells[0, 2], cells[0, 3], cells[0, 4] = at[0], at[1], at[2], 0, count
    depth = 1
    while depth > 0:
        depth -= 1
        here = cells[depth, 0], cells[depth, 1], cells[depth, 2]
        first, last = cells[depth, 3], cells[depth, 4]
        if last - first > CROWD and here[2] > _FINEST and last + 4 * (last - first) <= len(lists):
            depth = _into_four(triangles, owner, here, first, last, lists, cells, depth)
            continue
        if 3 + last - first + 8 >= len(room[0]):
            return False
        found = _gather(triangles, owner, here, first, last, lists, chosen, room[0])
        known = edges if here[2] == at[2] and found == count else np.int64(-1)
        enough &= settle_cell(triangles, here, chosen, found, pieces, room, known)
        side = 1.0 / (1 << (at[2] - here[2]))
        across, down = here[0] * side - at[0], here[1] * side - at[1]
        for i in range(found):
            k, area = lists[first + i], sums[i, 0] * side * side
            seen[k, 0] += area
            seen[k, 1] += area * across + sums[i, 1] * side * side * side
            seen[k, 2] += area * down + sums[i, 2] * side * side * side
    return enough


@inner
def _into_four(triangles, owner, here, first, last, lists, cells, depth):
    """A cell's quarters, each with a list of its pieces, to the cells from `depth` on; how many there are then."""
    x, y, _, corner, _ = triangles
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
def _gather(triangles, owner, here, first, last, lists, chosen, pool):
    """The polygons of a cell's pieces to the pool, from slot 3 on, and their triangles; how many there are. The list
    then begins with these."""
    x, y, _, corner, _ = triangles
    found = 0
    for i in range(first, last):
        t, slot = owner[lists[i]], 3 + found
        polygon(pool, slot, x, y, corner[0, t], corner[1, t], corner[2, t], here)
        if pool[slot, SIZE] >= 3 and measure(pool, slot)[0] > NOTHING:
            hold(pool, slot, found)
            chosen[found], lists[first + found] = t, lists[i]
            found += 1
    return found


@inner
def _meets(x, y, corner, t, at):
    """Whether the box of a triangle reaches into a cell."""
    a, b, c = corner[0, t], corner[1, t], corner[2, t]
    left, top, side = at[0] << at[2], at[1] << at[2], 1 << at[2]
    across = (max(x[a], x[b], x[c]) > left) & (min(x[a], x[b], x[c]) < left + side)
    return across & (max(y[a], y[b], y[c]) > top) & (min(y[a], y[b], y[c]) < top + side)


@loop
def _scratch(count):
    """For so many pieces of a pixel."""
    lists, cells = np.empty(12 * count, np.int64), np.empty((64, 5), np.int64)
    return np.empty((count, NUMBERS)), np.empty(count, np.int64), np.empty((count, 3)), lists, cells


@loop
def _room(count, slots):
    """Slots for polygons, and scratch for so many pieces."""
    table = 8
    while table < 6 * count:
        table *= 2
    slots = max(slots, count + 16)
    return (
        np.empty((slots, SLOT)), np.empty((table, 2), np.int64), np.empty(count, np.int64),
        np.empty((9 * count + 3000, SEGMENT)), np.empty(16 * slots, np.int64), np.empty((256, 6), np.int64),
        np.empty((count, 3)), np.empty(slots, np.int64),
    )  # fmt: skip


@inner
def _write_back(share, start, sums, count):
    for i in range(count):
        area = sums[i, 0]
        share[0, start + i] = area if area > NOTHING else 0.0
        for k in range(1, 3):
            share[k, start + i] = min(max(sums[i, k] / area, 0.0), 1.0) if area > 0 else 0.0
