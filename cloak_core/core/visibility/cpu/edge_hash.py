"""Hashes of edges, which tell boundary edges (edges of a single triangle) from shared ones.

Overlap depth changes only at boundary edges. The hash is antisymmetric, h(a, b) = -h(b, a): contributions of
neighbouring triangles cancel. So where the sum over the edges that cross a pixel is 0, every point of the pixel lies in
equally many triangles: if the areas also add up to 1, nothing overlaps and nothing is left open.

Exact up to a coincidence: that 64 bits of different edges add up to 0 has a probability of about 2^-60 a pixel, and the
areas would have to add up to 1 besides.
"""

from __future__ import annotations

import numpy as np

from cloak_core.core.visibility.compiled import inner, loop

WHOLE = 1e-6
"""Shares that add up to 1 within this fill the pixel once where all edges are shared: else they add up to 0 or 2."""
_MIX = 0x2545F4914F6CDD1D
"""The multiplier of xorshift64* (Vigna 2016); shifts on both sides of it spread every bit over the others."""
_OTHER = 0x1B873593CC9E2D51
"""Those of MurmurHash3, put together. Two unlike hashes make h(a, b) = f(a) g(b) - f(b) g(a) antisymmetric, not 0."""
_START = 0x5851F42D4C957F2D
"""With this no place inside the guard band hashes to 0, which would tell nothing."""


@loop
def hash_corners(x, y):
    """Hash every corner twice [2, K], by its place and not its index: seams of a mesh are closed, too."""
    hashes = np.empty((2, len(x)), np.int64)
    for i in range(len(x)):
        key = _START ^ (np.int64(y[i]) << 32) ^ x[i]
        first = (key ^ (key >> 29)) * np.int64(_MIX)
        second = (key ^ (key >> 31)) * np.int64(_OTHER)
        hashes[0, i], hashes[1, i] = first ^ (first >> 32), second ^ (second >> 30)
    return hashes


@inner
def edge_hash(hashes, a, b):
    """Compute the antisymmetric hash of the edge from corner a to corner b."""
    return hashes[0, a] * hashes[1, b] - hashes[0, b] * hashes[1, a]


@inner
def edge_sum(x, y, hashes, a, b, c, twice, at):
    """Sum the hashes of a triangle's edges that may cross the inside of a cell (column, row, size as a shift)."""
    turn = -1 if twice > 0 else 1
    return turn * (_edge(x, y, hashes, a, b, at) + _edge(x, y, hashes, b, c, at) + _edge(x, y, hashes, c, a, at))


@inner
def _edge(x, y, hashes, a, b, at):
    """Compute the hash of an edge whose box reaches into a cell, else 0."""
    column, row, shift = at
    left, top, side = column << shift, row << shift, 1 << shift
    across = (max(x[a], x[b]) > left) & (min(x[a], x[b]) < left + side)
    may_cross = across & (max(y[a], y[b]) > top) & (min(y[a], y[b]) < top + side)
    return edge_hash(hashes, a, b) if may_cross else np.int64(0)
