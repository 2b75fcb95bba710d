"""A pixel of more pieces than can be resolved exactly in bounded time: 64 x 64 samples, as numba loops."""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import loop
from cloak_core.render.cpu.sampling import cover_box, span
from cloak_core.render.cpu.triangles import doubled_area, in_order
from cloak_core.render.packing import EMPTY, ID_BITS
from cloak_core.render.screen import GRID

SIDE = 64
"""Samples along each side of a crowded pixel."""
_SHIFT = (GRID // SIDE).bit_length() - 1
_ID = (1 << ID_BITS) - 1


@loop
def sample_pixel(mesh, column, row, owner, share, packed, sums):
    """Sample the pieces of one pixel: area and centroid of each visible one into `share` [3, n], 0 for the others.

    owner [n]: their triangles; packed [SIDE, SIDE] and sums [n, 3] are workspace.
    """
    # Names ascend with triangle ids, so that equal depths go to the lower id.
    order = np.argsort(mesh.ids[owner])
    row0, column0 = row * SIDE, column * SIDE
    packed[:] = EMPTY
    sums[: len(owner)] = 0
    for name in range(len(order)):
        if share[0, order[name]] > 0:
            _cover(mesh, owner[order[name]], name, packed, row0, column0)
    for y in range(SIDE):
        for x in range(SIDE):
            if packed[y, x] != EMPTY:
                piece = order[packed[y, x] & _ID]
                sums[piece, 0] += 1
                sums[piece, 1] += x
                sums[piece, 2] += y
    for piece in range(len(owner)):
        held = sums[piece, 0]
        share[0, piece] = held / (SIDE * SIDE)
        share[1, piece] = (sums[piece, 1] / held + 0.5) / SIDE if held > 0 else 0.0
        share[2, piece] = (sums[piece, 2] / held + 0.5) / SIDE if held > 0 else 0.0


@loop
def _cover(mesh, t, name, packed, row0, column0):
    a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
    c0, c1 = span(mesh.x[a], mesh.x[b], mesh.x[c], _SHIFT, column0, column0 + SIDE - 1)
    r0, r1 = span(mesh.y[a], mesh.y[b], mesh.y[c], _SHIFT, row0, row0 + SIDE - 1)
    if (c0 <= c1) & (r0 <= r1):
        corners = in_order(mesh.x, mesh.y, a, b, c, doubled_area(mesh.x, mesh.y, a, b, c))
        cover_box(packed, mesh.x, mesh.y, mesh.inverse_depth, corners, name, r0, r1, c0, c1, row0, column0, _SHIFT)
