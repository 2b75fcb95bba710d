"""Visibility by exact area, as numba loops, band by band of rows, so that memory is that of one band."""

from __future__ import annotations

import warnings

import numpy as np
import torch

from cloak_core.core.view import CrowdedPixels, FlatTriangles, Fragments, Window
from cloak_core.core.visibility.compiled import loop
from cloak_core.core.visibility.cpu.edge_hash import WHOLE, hash_corners
from cloak_core.core.visibility.cpu.hidden_parts import cut_hidden
from cloak_core.core.visibility.cpu.pieces import NOTHING, find_candidates, find_pieces, sort_by_pixel
from cloak_core.core.visibility.cpu.sampling import sample_pixel
from cloak_core.core.visibility.cpu.triangles import PIXEL
from cloak_core.core.visibility.cpu.workspace import Mesh, make_workspace

MOST_PAIRS = 1 << 20
"""Pairs of triangle and pixel at most in one band, or those of a single row."""
ROW_CUTS, PIXEL_CUTS = 1 << 19, 64
"""Most tests of a convex part against a triangle in a row of pixels; beyond, each pixel may still take the second
number. They are counted by row because bands depend on the number of threads."""


def visible_areas(flat: FlatTriangles, window: Window, width: int) -> list[Fragments]:
    """Find each triangle's exact visible share in each pixel of a window of an image `width` pixels wide.

    In parts from top to bottom. Warns of `CrowdedPixels`.
    """
    x, y, inverse_depth, corner, ids, one_sided = flat.arrays()
    mesh = Mesh(x, y, inverse_depth, corner, ids, hash_corners(x, y))
    columns = window.x0, window.x1
    candidates = find_candidates(x, y, corner, one_sided, *columns, window.y0, window.y1)
    fragments = []
    sampled = 0
    for top, bottom, pairs in _bands(candidates[-1], window):
        place, owner, coverage, edge_sum = find_pieces(mesh, candidates, *columns, top, bottom, pairs)
        pixels = window.x1 - window.x0, bottom - top
        owner, coverage, begin = sort_by_pixel(place, owner, coverage, pixels[0] * pixels[1])
        sampled += resolve_visibility(mesh, owner, coverage, begin, edge_sum, window.x0, top, pixels[0])
        band = _emit(ids, owner, coverage, begin, window.x0, top, pixels[0], width)
        fragments.append(Fragments(*map(torch.from_numpy, band)))
    if sampled:
        warnings.warn(CrowdedPixels(sampled), stacklevel=2)
    return fragments


def _bands(load: np.ndarray, window: Window) -> list[tuple[int, int, int]]:
    """Cut the window into bands that are not empty, of at most `MOST_PAIRS` or one row: rows from .. to, and pairs."""
    bands = []
    start = window.y0
    held = 0
    for row, pairs in enumerate(load.tolist(), window.y0):
        if held and held + pairs > MOST_PAIRS:
            bands.append((start, row, held))
            held = 0
        if not held:
            start = row
        held += pairs
    return [*bands, (start, window.y1, held)] if held else bands


@loop
def resolve_visibility(mesh, owner, coverage, begin, edge_sum, x0, y0, width):
    """Reduce the pieces of a band to what is visible of them, in place: share of the pixel (0: hidden) and centroid.

    owner: int32 [n], the triangle of each piece, sorted by pixel; coverage: float32 [3, n], area and centroid, changed
    in place; begin: int64 [pixels + 1], where each pixel's pieces begin; edge_sum: int64 [pixels] (edge_hash.py); x0,
    y0, width: the band's left and top and its columns. Pixels in which nothing overlaps stay as they are. Returns how
    many pixels had to be sampled.
    """
    most, sampled, cuts = 64, 0, 0
    work = make_workspace(most)
    for place in range(len(begin) - 1):
        start = begin[place]
        count = begin[place + 1] - begin[place]
        cuts = cuts if place % width else 0  # a row begins: its tests are counted anew
        if count < 2:
            continue
        total = 0.0
        for i in range(start, start + count):
            total += coverage[0, i]
        # All edges are shared and the areas add up to 1: every point is covered once, nothing is hidden.
        if edge_sum[place] == 0 and abs(total - 1) <= WHOLE:
            continue
        if count > most:
            most = 2 * count  # doubled, so that memory is allocated rarely
            work = make_workspace(most)
        at = x0 + place % width, y0 + place // width, PIXEL
        own = slice(start, start + count)
        used, exact = cut_hidden(mesh, at, owner[own], coverage[:, own], work, max(ROW_CUTS - cuts, PIXEL_CUTS))
        cuts += used
        if not exact:
            sampled += 1
            sample_pixel(mesh, at[0], at[1], owner[own], coverage[:, own])
    return sampled


@loop
def _emit(ids, owner, coverage, begin, x0, y0, width, image_width):
    """List the visible pieces: pixel and triangle int64, area float32, the centroid in pixels float64, [m] each.

    ids: int64 [N], of the triangles; image_width: columns of the whole image; the rest as `resolve_visibility`.
    """
    most = len(owner)
    count = 0
    pixel, triangle, area = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.float32)
    x, y = np.empty(most), np.empty(most)
    for p in range(len(begin) - 1):
        column, row = x0 + p % width, y0 + p // width
        for i in range(begin[p], begin[p + 1]):
            if coverage[0, i] > NOTHING:
                pixel[count] = row * image_width + column
                triangle[count] = ids[owner[i]]
                area[count] = coverage[0, i]
                x[count], y[count] = column + coverage[1, i], row + coverage[2, i]
                count += 1
    # Copies: what is not used of these arrays should not stay in memory.
    return pixel[:count].copy(), triangle[:count].copy(), area[:count].copy(), x[:count].copy(), y[:count].copy()
