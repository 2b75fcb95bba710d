"""Visibility by exact area, as loops for the CPU, band by band of rows: memory is that of one band."""

from __future__ import annotations

import warnings

import numpy as np
import torch

from cloak_core.render.compiled import loop
from cloak_core.render.visibility.areas import CrowdedPixels, Found
from cloak_core.render.visibility.flat import FlatTriangles
from cloak_core.render.visibility.overlap_loops import NOTHING, by_place, find_candidates, find_pieces, hash_corners
from cloak_core.render.visibility.projection import Window
from cloak_core.render.visibility.settle_loops import settle

MOST_PAIRS = 1 << 20
"""Pairs of triangle and pixel at most in one band, or those of a single row."""


def seen_areas(flat: FlatTriangles, window: Window, width: int) -> list[Found]:
    """See areas.py. Warns of `CrowdedPixels`."""
    x, y, nearness, corner, ids, one_sided = flat.arrays()
    columns = window.x0, window.x1
    candidates = find_candidates(x, y, corner, one_sided, *columns, window.y0, window.y1)
    found, lost, hashes = [], 0, hash_corners(x, y)
    triangles = x, y, nearness, corner, ids, hashes
    for top, bottom in _bands(candidates[-1], window):
        place, owner, share, open_edges = find_pieces(x, y, nearness, corner, hashes, candidates, *columns, top, bottom)
        pixels = window.x1 - window.x0, bottom - top
        owner, share, begin = by_place(place, owner, share, pixels[0] * pixels[1])
        lost += settle(triangles, owner, share, begin, open_edges, window.x0, top, pixels[0])
        band = _emit(ids, owner, share, begin, window.x0, top, pixels[0], width)
        found.append(tuple(map(torch.from_numpy, band)))
    if lost:
        warnings.warn(CrowdedPixels(lost), stacklevel=2)
    return found


def _bands(load: np.ndarray, window: Window) -> list[tuple[int, int]]:
    """Rows from .. to (exclusive), each with at most `MOST_PAIRS`, or a single row; without those that hold nothing."""
    bands, start, held = [], window.y0, 0
    for row, pairs in enumerate(load.tolist(), window.y0):
        if held and held + pairs > MOST_PAIRS:
            bands.append((start, row))
            held = 0
        if not held:
            start = row
        held += pairs
    return [*bands, (start, window.y1)] if held else bands


@loop
def _emit(ids, owner, share, begin, x0, y0, width, image_width):
    """What is left of the pieces: pixel, triangle, area, and the centroid in pixels."""
    most, count = len(owner), 0
    pixel, triangle, area = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.float32)
    at = np.empty((2, most))
    for p in range(len(begin) - 1):
        column, row = x0 + p % width, y0 + p // width
        for i in range(begin[p], begin[p + 1]):
            if share[0, i] > NOTHING:
                pixel[count], triangle[count], area[count] = row * image_width + column, ids[owner[i]], share[0, i]
                at[0, count], at[1, count] = column + share[1, i], row + share[2, i]
                count += 1
    return pixel[:count].copy(), triangle[:count].copy(), area[:count].copy(), at[:, :count].copy()
