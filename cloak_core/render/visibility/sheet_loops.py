"""Pixels where one sheet is plainly all that is seen, as loops for the CPU.

Pieces that hang together by shared edges are a sheet; one without open edges that has the area of the cell fills it
just once. It hides what touches none but those of 8 x 8 fields in which it lies before the rest. Depths are compared as
what they differ by from the plane of the sheet's largest piece, so that slanting surfaces close to each other are told
apart.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner, loop
from cloak_core.render.visibility.covering_loops import doubled_area
from cloak_core.render.visibility.edge_loops import OWNER, SEGMENT, find_open, nothing_overlaps, root
from cloak_core.render.visibility.overlap_loops import WHOLE, slopes

_SIDE = 8
_MARGIN = 2.0**-40
"""Nearness by which a sheet must lie before the rest; depths themselves are told apart by 2^-42."""


@inner
def settle_plainly(triangles, at, chosen, owner, share, start, found, room):
    """Settle what is plain in a pixel: all there is, or one sheet before all the rest, whose shares are then set to 0.
    Returns how many pieces are left, which then come first; and how many open edges these have if the room still holds
    them, else -1.

    triangles: x, y, nearness, corner, ids and hashes of them all; at: column, row and size of the cell; chosen
    [found]: the triangle of each piece, as `owner` has it from `start` on; share [3]: area and centroid of each, from
    `start` on; room: see `edge_room`.
    """
    x, y, _, corner, _, _ = triangles
    table, group, segments, fields = room[0], room[1], room[2], room[7]
    count, total = find_open(triangles, chosen, found, at, table, group, segments), 0.0
    for i in range(found):
        total += share[0, start + i]
    if total <= 1 + WHOLE and nothing_overlaps(x, y, corner, chosen, found, at, segments, count):
        return 0, count
    first = _whole_sheet(triangles, chosen, share, start, found, room, count)
    if first < 0:
        return found, count
    unclear, rest, left = _unclear_fields(triangles, at, chosen, share, start, found, room, first), np.int64(0), 0
    for i in range(found):
        if group[i] != first:
            hidden = fields[i] & unclear == 0
            share[0, start + i] *= not hidden
            rest |= 0 if hidden else fields[i]
    for i in range(found):
        if fields[i] & (rest if group[i] == first else unclear):
            _swap(chosen, owner, share, group, start, i, left)
            left += 1
    return left, count if left == found else -1


@inner
def _swap(chosen, owner, share, group, start, i, k):
    """Let two pieces of a pixel change places."""
    group[i], group[k] = group[k], group[i]
    chosen[i], chosen[k] = chosen[k], chosen[i]
    owner[start + i], owner[start + k] = chosen[i], chosen[k]
    for n in range(3):
        share[n, start + i], share[n, start + k] = share[n, start + k], share[n, start + i]


@inner
def _whole_sheet(triangles, chosen, share, start, found, room, count):
    """The nearest sheet without open edges that fills the pixel, or -1. Sheets are known by their first piece, which
    then stands for each of their pieces in the room's `group`."""
    _, _, nearness, corner, _, _ = triangles
    _, group, segments, areas, nearest, _, _, _ = room
    for i in range(found):
        group[i] = root(group, i)
        areas[i], nearest[i] = 0.0, -1.0
    for k in range(count):
        areas[group[int(segments[k, OWNER])]] = -np.inf
    for i in range(found):
        t, own = chosen[i], group[i]
        near = max(nearness[corner[0, t]], nearness[corner[1, t]], nearness[corner[2, t]])
        areas[own], nearest[own] = areas[own] + share[0, start + i], max(nearest[own], near)
    first = -1
    for i in range(found):
        if abs(areas[i] - 1) <= WHOLE and (first < 0 or nearest[i] > nearest[first]):
            first = i
    return first


@inner
def _unclear_fields(triangles, at, chosen, share, start, found, room, first):
    """The fields in which a sheet does not plainly lie before all other pieces, as bits; the room's `fields` are then
    those that each piece touches."""
    x, y, nearness, corner, _, _ = triangles
    group, front, back, fields, largest = room[1], room[5], room[6], room[7], first
    for i in range(found):
        if group[i] == first and share[0, start + i] > share[0, start + largest]:
            largest = i
    level = _plane(x, y, nearness, corner, chosen[largest], at)
    front[:], back[:] = np.inf, -np.inf
    for i in range(found):
        own, t = group[i] == first, chosen[i]
        a, b, c = corner[0, t], corner[1, t], corner[2, t]
        here = _plane(x, y, nearness, corner, t, at)
        begin, across, down = here[0] - level[0], here[1] - level[1], here[2] - level[2]
        n0, n1, n2 = (
            _over(x, y, nearness, a, at, level),
            _over(x, y, nearness, b, at, level),
            _over(x, y, nearness, c, at, level),
        )
        least, most = min(n0, n1, n2), max(n0, n1, n2)
        left, right, u0, u1 = _fields(x[a], x[b], x[c], at[0], at[2])
        top, bottom, v0, v1 = _fields(y[a], y[b], y[c], at[1], at[2])
        fields[i] = 0
        for row in range(v0, v1 + 1):
            above, below = down * max(top, row / _SIDE), down * min(bottom, (row + 1) / _SIDE)
            for column in range(u0, u1 + 1):
                near, far = across * max(left, column / _SIDE), across * min(right, (column + 1) / _SIDE)
                field = row * _SIDE + column
                fields[i] |= np.int64(1) << field
                if own:
                    front[field] = min(front[field], max(least, begin + min(above, below) + min(near, far)))
                else:
                    back[field] = max(back[field], min(most, begin + max(above, below) + max(near, far)))
    unclear = np.int64(0)
    for field in range(_SIDE * _SIDE):
        unclear |= np.int64(not back[field] + _MARGIN < front[field]) << field
    return unclear


@inner
def _over(x, y, nearness, p, at, level):
    """How far a corner lies over a plane."""
    right, below, side = np.int64(x[p]) - (at[0] << at[2]), np.int64(y[p]) - (at[1] << at[2]), 1 << at[2]
    return nearness[p] - (level[0] + (level[1] * right + level[2] * below) / side)


@inner
def _plane(x, y, nearness, corner, t, at):
    """Nearness of a triangle's plane at a cell's corner, and what it changes by over the cell right and down."""
    a, b, c = corner[0, t], corner[1, t], corner[2, t]
    origin, across, down = slopes(x, y, nearness, a, b, c, doubled_area(x, y, a, b, c))
    column, row, shift = at
    right, below, side = (column << shift) - np.int64(x[origin]), (row << shift) - np.int64(y[origin]), 1 << shift
    return nearness[origin] + across * right + down * below, across * side, down * side


@inner
def _fields(a, b, c, cell, shift):
    """What of a triangle lies in a cell along one axis: from .. to, in sides of the cell, and its first and last
    field."""
    side = 1 << shift
    low, high = max(np.int64(min(a, b, c)) - (cell << shift), 0), min(np.int64(max(a, b, c)) - (cell << shift), side)
    return low / side, high / side, low * _SIDE >> shift, min(high * _SIDE >> shift, _SIDE - 1)


@loop
def edge_room(count):
    """Scratch for so many pieces: a table and a tree of edges, open edges, areas and depths of sheets, depths in
    fields, and the fields of each piece."""
    table = 8
    while table < 6 * count:
        table *= 2
    edges = np.empty((table, 2), np.int64), np.empty(count, np.int64), np.empty((3 * count, SEGMENT))
    depths = np.empty(count), np.empty(count), np.empty(_SIDE * _SIDE), np.empty(_SIDE * _SIDE)
    return *edges, *depths, np.empty(count, np.int64)
