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
    """See `Backend.visible_areas`."""
    x, y, inverse_depth, corner, ids, one_sided = flat.arrays()
    mesh = Mesh(x, y, inverse_depth, corner, ids, hash_corners(x, y))
    columns = window.x0, window.x1
    candidates = find_candidates(x, y, corner, one_sided, *columns, window.y0, window.y1)
    found, sampled = [], 0
    for top, bottom, pairs in _bands(candidates[-1], window):
        place, owner, share, edge_sum = find_pieces(mesh, candidates, *columns, top, bottom, pairs)
        pixels = window.x1 - window.x0, bottom - top
        owner, share, begin = sort_by_pixel(place, owner, share, pixels[0] * pixels[1])
        sampled += resolve_visibility(mesh, owner, share, begin, edge_sum, window.x0, top, pixels[0])
        band = _emit(ids, owner, share, begin, window.x0, top, pixels[0], width)
        found.append(Fragments(*map(torch.from_numpy, band)))
    if sampled:
        warnings.warn(CrowdedPixels(sampled), stacklevel=2)
    return found


def _bands(load: np.ndarray, window: Window) -> list[tuple[int, int, int]]:
    """Cut the window into bands that are not empty, of at most `MOST_PAIRS` or one row: rows from .. to, and pairs."""
    bands, start, held = [], window.y0, 0
    for row, pairs in enumerate(load.tolist(), window.y0):
        if held and held + pairs > MOST_PAIRS:
            bands.append((start, row, held))
            held = 0
        if not held:
            start = row
        held += pairs
    return [*bands, (start, window.y1, held)] if held else bands


@loop
def resolve_visibility(mesh, owner, share, begin, edge_sum, x0, y0, width):
    """Reduce the pieces of a band to what is visible of them, in place: share of the pixel (0: hidden) and centroid.

    begin [pixels + 1]: where each pixel's pieces begin. Pixels in which nothing overlaps stay as they are. Returns how
    many pixels had to be sampled.
    """
    most, sampled, cuts = 64, 0, 0
    work = make_workspace(most)
    for place in range(len(begin) - 1):
        start, count = begin[place], begin[place + 1] - begin[place]
        cuts = cuts if place % width else 0
        if count < 2:
            continue
        total = 0.0
        for i in range(start, start + count):
            total += share[0, i]
        if edge_sum[place] == 0 and abs(total - 1) <= WHOLE:
            continue
        if count > most:
            most = 2 * count
            work = make_workspace(most)
        at = x0 + place % width, y0 + place // width, PIXEL
        own = slice(start, start + count)
        used, exact = cut_hidden(mesh, at, owner[own], share[:, own], work, max(ROW_CUTS - cuts, PIXEL_CUTS))
        cuts += used
        if not exact:
            sampled += 1
            sample_pixel(mesh, at[0], at[1], owner[own], share[:, own])
    return sampled


@loop
def _emit(ids, owner, share, begin, x0, y0, width, image_width):
    """List the visible pieces: pixel, triangle, area, and the centroid in pixels."""
    most, count = len(owner), 0
    pixel, triangle, area = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.float32)
    x, y = np.empty(most), np.empty(most)
    for p in range(len(begin) - 1):
        column, row = x0 + p % width, y0 + p // width
        for i in range(begin[p], begin[p + 1]):
            if share[0, i] > NOTHING:
                pixel[count], triangle[count], area[count] = row * image_width + column, ids[owner[i]], share[0, i]
                x[count], y[count] = column + share[1, i], row + share[2, i]
                count += 1
    return pixel[:count].copy(), triangle[:count].copy(), area[:count].copy(), x[:count].copy(), y[:count].copy()
