"""Pixels where one sheet of connected pieces hides most others, as numba loops.

Pieces connected by shared edges are a sheet (union-find); one without boundary edges inside the pixel that has the area
of the pixel fills it just once. It hides all but the pieces in those of 8 x 8 fields where it is not clearly in front.
Depths are compared as differences from the plane of the sheet's largest piece, so that slanting surfaces close to each
other are told apart.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import inner
from cloak_core.render.cpu.edge_hash import edge_hash, may_cross
from cloak_core.render.cpu.polygons import TOUCH
from cloak_core.render.cpu.triangles import clockwise, doubled_area, slopes
from cloak_core.render.cpu.workspace import FIELDS

WHOLE = 1e-6
"""Shares that add up to 1 within this fill the pixel once where all edges are shared: else they add up to 0 or 2."""
_MARGIN = 2.0**-40
"""Inverse depth by which a sheet must lie before the rest; depths themselves are told apart by 2^-42."""


@inner
def drop_behind_sheet(mesh, at, owner, share, start, found, work):
    """Drop the pieces of a pixel that lie clearly behind one sheet that fills it: their shares become 0.

    at: column, row and size (as a shift) of the pixel; owner and share [3]: triangle, and area and centroid, of each
    piece from `start` on. Returns how many pieces are still to be resolved; these come first then.
    """
    _find_sheets(mesh, at, found, work)
    first = _whole_sheet(mesh, share, start, found, work)
    if first < 0:
        return found
    unclear, rest, left = _unclear_fields(mesh, at, share, start, found, work, first), np.int64(0), 0
    sheet, fields = work.sheet, work.fields
    for i in range(found):
        if sheet[i] != first:
            hidden = fields[i] & unclear == 0
            share[0, start + i] *= not hidden
            rest |= 0 if hidden else fields[i]
    for i in range(found):
        if fields[i] & (rest if sheet[i] == first else unclear):
            _swap(work.chosen, owner, share, sheet, start, i, left)
            left += 1
    return left


@inner
def _swap(chosen, owner, share, sheet, start, i, k):
    """Let two pieces of a pixel change places."""
    sheet[i], sheet[k] = sheet[k], sheet[i]
    chosen[i], chosen[k] = chosen[k], chosen[i]
    owner[start + i], owner[start + k] = chosen[i], chosen[k]
    for n in range(3):
        share[n, start + i], share[n, start + k] = share[n, start + k], share[n, start + i]


@inner
def _find_sheets(mesh, at, found, work):
    """Connect pieces that share an edge inside the pixel; sheets with a boundary edge there get area -inf, others 0."""
    table, sheet, size = work.edges, work.sheet, 8
    while size < 6 * found:
        size *= 2
    table[:size, 1] = 0
    for i in range(found):
        sheet[i], work.sheet_area[i], work.sheet_nearest[i] = i, 0.0, -1.0
    for i in range(found):
        p, q, r = clockwise(mesh.x, mesh.y, mesh.corner, work.chosen[i])
        for k in range(3):
            if may_cross(mesh.x, mesh.y, p, q, at):
                _enter(table, size - 1, edge_hash(mesh.hashes, p, q), 3 * i + k + 1, sheet)
            p, q, r = q, r, p
    for slot in range(size):
        if table[slot, 1] > 0:
            i, turns = divmod(table[slot, 1] - 1, 3)
            p, q, r = clockwise(mesh.x, mesh.y, mesh.corner, work.chosen[i])
            for _ in range(turns):
                p, q, r = q, r, p
            if _crosses(mesh.x, mesh.y, p, q, at):
                work.sheet_area[_root(sheet, i)] = -np.inf


@inner
def _enter(table, mask, number, name, sheet):
    """Take an edge out of the hash table where its other side is in, and join the two sheets; else put it in."""
    slot = abs(number) & mask
    while table[slot, 1] != 0:
        if table[slot, 1] > 0 and table[slot, 0] == -number:
            one, other = _root(sheet, (table[slot, 1] - 1) // 3), _root(sheet, (name - 1) // 3)
            sheet[max(one, other)] = min(one, other)
            table[slot, 1] = -1
            return
        slot = (slot + 1) & mask
    table[slot, 0], table[slot, 1] = number, name


@inner
def _root(sheet, i):
    """Find the first piece of the sheet that piece i belongs to."""
    while sheet[i] != i:
        sheet[i] = sheet[sheet[i]]
        i = sheet[i]
    return i


@inner
def _crosses(x, y, p, q, at):
    """Test whether more than a point of an edge lies in a cell (Liang-Barsky)."""
    column, row, shift = at
    side = 1 << shift
    x0, y0 = (np.int64(x[p]) - (column << shift)) / side, (np.int64(y[p]) - (row << shift)) / side
    x1, y1 = (np.int64(x[q]) - (column << shift)) / side, (np.int64(y[q]) - (row << shift)) / side
    first, last = 0.0, 1.0
    for k in range(2):
        start, step = (x0, x1 - x0) if k == 0 else (y0, y1 - y0)
        if step != 0:
            one, other = -start / step, (1 - start) / step
            first, last = max(first, min(one, other)), min(last, max(one, other))
    return (last > first) & ((last - first) * (abs(x1 - x0) + abs(y1 - y0)) > TOUCH)


@inner
def _whole_sheet(mesh, share, start, found, work):
    """Find the nearest sheet without boundary edges that fills the pixel, by its first piece, or -1."""
    sheet, area, nearest = work.sheet, work.sheet_area, work.sheet_nearest
    for i in range(found):
        t, own = work.chosen[i], _root(sheet, i)
        sheet[i] = own
        a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
        near = max(mesh.inverse_depth[a], mesh.inverse_depth[b], mesh.inverse_depth[c])
        area[own], nearest[own] = area[own] + share[0, start + i], max(nearest[own], near)
    first = -1
    for i in range(found):
        if abs(area[i] - 1) <= WHOLE and (first < 0 or nearest[i] > nearest[first]):
            first = i
    return first


@inner
def _unclear_fields(mesh, at, share, start, found, work, first):
    """Find the fields in which a sheet is not clearly before all else, as bits, and the fields of each piece."""
    largest = first
    for i in range(found):
        if work.sheet[i] == first and share[0, start + i] > share[0, start + largest]:
            largest = i
    level = _plane(mesh, work.chosen[largest], at)
    work.sheet_depth[:], work.other_depth[:] = np.inf, -np.inf
    for i in range(found):
        work.fields[i] = _depths_in_fields(mesh, at, work.chosen[i], level, work.sheet[i] == first, work)
    unclear = np.int64(0)
    for field in range(FIELDS * FIELDS):
        unclear |= np.int64(not work.other_depth[field] + _MARGIN < work.sheet_depth[field]) << field
    return unclear


@inner
def _depths_in_fields(mesh, at, t, level, own, work):
    """Update the bounds of depth in the fields that a triangle touches; returns these fields as bits."""
    a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
    here = _plane(mesh, t, at)
    begin, across, down = here[0] - level[0], here[1] - level[1], here[2] - level[2]
    n0, n1, n2 = _over(mesh, a, at, level), _over(mesh, b, at, level), _over(mesh, c, at, level)
    least, most, touched = min(n0, n1, n2), max(n0, n1, n2), np.int64(0)
    left, right, u0, u1 = _extent(mesh.x[a], mesh.x[b], mesh.x[c], at[0], at[2])
    top, bottom, v0, v1 = _extent(mesh.y[a], mesh.y[b], mesh.y[c], at[1], at[2])
    for row in range(v0, v1 + 1):
        above, below = down * max(top, row / FIELDS), down * min(bottom, (row + 1) / FIELDS)
        for column in range(u0, u1 + 1):
            near, far = across * max(left, column / FIELDS), across * min(right, (column + 1) / FIELDS)
            field = row * FIELDS + column
            touched |= np.int64(1) << field
            if own:
                low = max(least, begin + min(above, below) + min(near, far))
                work.sheet_depth[field] = min(work.sheet_depth[field], low)
            else:
                high = min(most, begin + max(above, below) + max(near, far))
                work.other_depth[field] = max(work.other_depth[field], high)
    return touched


@inner
def _over(mesh, p, at, level):
    """Compute how far a corner lies over a plane."""
    right, below = np.int64(mesh.x[p]) - (at[0] << at[2]), np.int64(mesh.y[p]) - (at[1] << at[2])
    return mesh.inverse_depth[p] - (level[0] + (level[1] * right + level[2] * below) / (1 << at[2]))


@inner
def _plane(mesh, t, at):
    """Inverse depth of a triangle's plane at a cell's corner, and its change over the cell right and down."""
    a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
    twice = doubled_area(mesh.x, mesh.y, a, b, c)
    origin, across, down = slopes(mesh.x, mesh.y, mesh.inverse_depth, a, b, c, twice)
    column, row, shift = at
    right, below = (column << shift) - np.int64(mesh.x[origin]), (row << shift) - np.int64(mesh.y[origin])
    return mesh.inverse_depth[origin] + across * right + down * below, across * (1 << shift), down * (1 << shift)


@inner
def _extent(a, b, c, cell, shift):
    """Compute a triangle's extent in a cell along one axis: from, to (in sides of the cell), first and last field."""
    side = 1 << shift
    low, high = max(np.int64(min(a, b, c)) - (cell << shift), 0), min(np.int64(max(a, b, c)) - (cell << shift), side)
    return low / side, high / side, low * FIELDS >> shift, min(high * FIELDS >> shift, FIELDS - 1)
