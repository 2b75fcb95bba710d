"""The named arrays that the area loops share: tuples of arrays, which numba compiles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cloak_core.render.compiled import loop
from cloak_core.render.cpu.polygons import SLOT

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

    chosen: np.ndarray
    """The triangle of each piece [n]."""
    edges: np.ndarray
    """Hash table of edges, hash and name [K, 2], K a power of two."""
    sheet: np.ndarray
    """Union-find forest: pieces connected by shared edges are one sheet, known by its first piece [n]."""
    sheet_area: np.ndarray
    sheet_nearest: np.ndarray
    """Of each sheet, at its first piece [n]."""
    fields: np.ndarray
    """The fields that each piece touches, as bits [n]."""
    sheet_depth: np.ndarray
    other_depth: np.ndarray
    """Least inverse depth of a sheet, and greatest of all else, over its plane in each field [64]."""
    pieces: np.ndarray
    """Of PIECE [n]."""
    hiders: np.ndarray
    """Pieces that may hide another one [n]."""
    pool: np.ndarray
    """Polygons, see polygons.py [MOST_PARTS, SLOT]."""
    visible: np.ndarray
    """Visible area of each piece and its moments in x and y; area -1 where nothing is hidden [n, 3]."""


@loop
def make_workspace(count):
    """Allocate the workspace for `count` pieces."""
    table = 8
    while table < 6 * count:
        table *= 2
    return Workspace(
        np.empty(count, np.int64),
        np.empty((table, 2), np.int64),
        np.empty(count, np.int64),
        np.empty(count),
        np.empty(count),
        np.empty(count, np.int64),
        np.empty(FIELDS * FIELDS),
        np.empty(FIELDS * FIELDS),
        np.empty(count, PIECE),
        np.empty(count, np.int64),
        np.empty((MOST_PARTS, SLOT)),
        np.empty((count, 3)),
    )
