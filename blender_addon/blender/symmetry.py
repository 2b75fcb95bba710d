# SPDX-License-Identifier: GPL-3.0-or-later
"""The other side of a body: which point lies nearest to a mirrored one. Numpy alone, for hundreds of thousands."""

from __future__ import annotations

import itertools

import numpy as np


def nearest_within(points: np.ndarray, queries: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """[Q] index of the point [N, 3] nearest to each query [Q, 3] within its own reach [Q] > 0; -1 where there is none.

    Points lie in the cells of a grid. Queries of like reach share one grid, whose cells are so large that a query's
    reach touches no more than two along each axis, and mostly one.
    """
    found = np.full(len(queries), -1, np.int64)
    levels = np.ceil(np.log2(reach)).astype(int)
    for level in np.unique(levels):
        chosen = np.flatnonzero(levels == level)
        found[chosen] = _nearest_in_grid(points, queries[chosen], reach[chosen], 2.0 ** (level + 2))
    return found


def _nearest_in_grid(points: np.ndarray, queries: np.ndarray, reach: np.ndarray, size: float) -> np.ndarray:
    keys = _key(np.floor(points / size))
    order = np.argsort(keys)
    keys = keys[order]
    firsts = np.flatnonzero(np.diff(keys, prepend=keys[0] - 1))
    keys, counts = keys[firsts], np.diff(firsts, append=len(keys))
    low, high = np.floor((queries - reach[:, None]) / size), np.floor((queries + reach[:, None]) / size)
    pairs = []
    for corner in itertools.product((False, True), repeat=3):
        # A reach within one cell along an axis would name that cell twice.
        once = np.flatnonzero(((low != high) | ~np.array(corner)).all(1))
        wanted = _key(np.where(corner, high, low)[once])
        place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        first, count = firsts[place], np.where(keys[place] == wanted, counts[place], 0)
        place = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
        pairs.append((np.repeat(once, count), order[place]))
    query, point = (np.concatenate(column) for column in zip(*pairs, strict=True))
    distance = np.linalg.norm(points[point] - queries[query], axis=1)
    near = distance <= reach[query]
    query, point, distance = query[near], point[near], distance[near]
    farthest_first = np.lexsort((-point, -distance))
    found = np.full(len(queries), -1, np.int64)
    found[query[farthest_first]] = point[farthest_first]  # the last one written stays
    return found


def _key(cells: np.ndarray) -> np.ndarray:
    """One number for each cell [n, 3]; that two may share one costs a comparison, no more."""
    x, y, z = cells.astype(np.int64).T
    return x * 73856093 ^ y * 19349663 ^ z * 83492791
