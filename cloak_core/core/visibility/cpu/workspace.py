"""The named arrays that the area loops share: tuples of arrays, which numba compiles; and how a piece is described.

Depth is a plane for each piece, three whole numbers: inverse depth at the pixel's corner times 2^42, and its change
over the pixel right and down. Differences of whole numbers do not round, so of any three triangles the order is
without contradiction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cloak_core.core.visibility.compiled import inner, loop
from cloak_core.core.visibility.cpu.polygons import SLOT, line_through
from cloak_core.core.visibility.cpu.triangles import doubled_area, in_order

DEPTH_STEPS = 2.0**42
"""Steps of inverse depth that are told apart."""
FIELDS = 8
"""A pixel is divided into 8 x 8 fields, bits of a 64-bit number, for quick tests of overlap."""
MOST_PARTS = 1024
"""Convex parts of one piece at most."""


class Mesh(NamedTuple):
    """N triangles on the snapped screen, between K corners."""

    x: np.ndarray
    """Grid units, int32 [K]."""
    y: np.ndarray
    inverse_depth: np.ndarray
    """float64 [K]."""
    corner: np.ndarray
    """int64 [3, N]."""
    ids: np.ndarray
    """int64 [N]."""
    hashes: np.ndarray
    """Two hashes of each corner, int64 [2, K]; see edge_hash.py."""


class Pixels(NamedTuple):
    """What is known of each pixel of a band while its pieces are found, [P] each."""

    edge_sum: np.ndarray
    """Sum of the hashes of the edges that cross the pixel; 0 where all edges are shared (edge_hash.py)."""
    front: np.ndarray
    """Least inverse depth of the nearest surface that fills the pixel; what lies behind is dropped."""
    total: np.ndarray
    """Sum of the areas of the pieces."""
    least: np.ndarray
    """Least inverse depth of the pieces."""


PIECE = np.dtype(
    [
        ("plane", np.float64, (3,)),  # inverse depth in steps of 2^-42 at the pixel's corner; change right and down
        ("bounds", np.float64, (2,)),  # least and greatest inverse depth, in steps
        ("id", np.int64),
        ("box", np.float64, (4,)),  # left, top, right, bottom
        ("corner", np.float64, (6,)),  # x and y of the triangle's corners, clockwise on the screen
        ("line", np.float64, (9,)),  # a, b, c of the lines of its edges, positive inside
    ]
)
"""A piece (a triangle within a pixel) in the pixel's coordinates: its corner is (0, 0), its side 1."""


class Workspace(NamedTuple):
    """Memory for the pieces of one pixel, allocated for up to n of them and used again and again."""

    fields: np.ndarray
    """The fields that each piece touches, as bits; 0 for one that is hidden [n]."""
    behind: np.ndarray
    """The greatest inverse depth of each piece, negative: pieces are sorted by it [n]."""
    order: np.ndarray
    """The pieces, nearest first [n]."""
    pieces: np.ndarray
    """Of PIECE [n]."""
    hiders: np.ndarray
    """Pieces that may hide another one [n]."""
    pool: np.ndarray
    """Polygons, see polygons.py [MOST_PARTS, SLOT]."""


@loop
def make_workspace(count):
    """Allocate the workspace for `count` pieces."""
    return Workspace(
        np.empty(count, np.int64),
        np.empty(count),
        np.empty(count, np.int64),
        np.empty(count, PIECE),
        np.empty(count, np.int64),
        np.empty((MOST_PARTS, SLOT)),
    )


@inner
def describe(mesh, t, at, pieces, i):
    """Write piece i, triangle t in the pixel's coordinates; returns the fields that its box touches, as bits."""
    a, b, c = mesh.corner[0, t], mesh.corner[1, t], mesh.corner[2, t]
    x, y = mesh.x, mesh.y
    p0, p1, p2 = in_order(x, y, a, b, c, doubled_area(x, y, a, b, c))
    column, row, shift = at
    side = 1 << shift
    x0, y0 = np.int64(x[p0]) - (column << shift), np.int64(y[p0]) - (row << shift)
    d1x, d1y = x[p1] - np.int64(x[p0]), y[p1] - np.int64(y[p0])
    d2x, d2y = x[p2] - np.int64(x[p0]), y[p2] - np.int64(y[p0])
    depths = mesh.inverse_depth[p0], mesh.inverse_depth[p1], mesh.inverse_depth[p2]
    _set_plane(pieces, i, (x0, y0), (d1x, d1y), (d2x, d2y), side, depths)
    pieces[i].id = mesh.ids[t]
    unit = 1.0 / side
    own = pieces[i]
    x0, y0, x1, y1, x2, y2 = (
        x0 * unit, y0 * unit, (x0 + d1x) * unit, (y0 + d1y) * unit, (x0 + d2x) * unit, (y0 + d2y) * unit
    )  # fmt: skip
    own.corner[0], own.corner[1], own.corner[2] = x0, y0, x1
    own.corner[3], own.corner[4], own.corner[5] = y1, x2, y2
    own.box[0], own.box[1] = max(min(x0, x1, x2), 0.0), max(min(y0, y1, y2), 0.0)
    own.box[2], own.box[3] = min(max(x0, x1, x2), 1.0), min(max(y0, y1, y2), 1.0)
    own.line[0], own.line[1], own.line[2] = line_through(x0, y0, x1, y1)
    own.line[3], own.line[4], own.line[5] = line_through(x1, y1, x2, y2)
    own.line[6], own.line[7], own.line[8] = line_through(x2, y2, x0, y0)
    return _fields(own.box[0], own.box[1], own.box[2], own.box[3])


@inner
def _set_plane(pieces, i, first, edge1, edge2, side, depths):
    """Write the plane of inverse depth, in steps, and its bounds within the pixel."""
    (x0, y0), (d1x, d1y), (d2x, d2y), (n0, n1, n2) = first, edge1, edge2, depths
    size = float(abs(d1x * d2y - d1y * d2x))
    e1, e2 = d2x * y0 - d2y * x0, d1y * x0 - d1x * y0
    slope1, slope2 = (n1 - n0) / size, (n2 - n0) / size
    # Rounded at three corners of the pixel, not in between: depths of two pieces are then compared in whole numbers.
    begin = _steps(e1, e2, slope1, slope2, n0)
    across = _steps(e1 + d2y * side, e2 - d1y * side, slope1, slope2, n0) - begin
    down = _steps(e1 - d2x * side, e2 + d1x * side, slope1, slope2, n0) - begin
    own = pieces[i]
    own.plane[0], own.plane[1], own.plane[2] = begin, across, down
    most, least = np.ceil(max(n0, n1, n2) * DEPTH_STEPS) + 1, np.floor(min(n0, n1, n2) * DEPTH_STEPS) - 1
    own.bounds[0] = max(begin + min(across, 0.0) + min(down, 0.0), least)
    own.bounds[1] = min(begin + max(across, 0.0) + max(down, 0.0), most)


@inner
def _steps(e1, e2, slope1, slope2, n0):
    return np.rint(((float(e1) * slope1 + float(e2) * slope2) + n0) * DEPTH_STEPS)


@inner
def _fields(left, top, right, bottom):
    """List the fields that a box touches, as bits."""
    u0 = np.int64(left * FIELDS)
    u1 = min(np.int64(right * FIELDS), FIELDS - 1)
    v0 = np.int64(top * FIELDS)
    v1 = min(np.int64(bottom * FIELDS), FIELDS - 1)
    row = (np.int64(2) << u1) - (np.int64(1) << u0)  # bits u0 to u1
    bits = np.int64(0)
    for v in range(v0, v1 + 1):
        bits |= row << (v * FIELDS)
    return bits
