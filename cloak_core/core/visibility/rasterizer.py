"""What is visible of triangles on the screen: the nearest at every sample, or exact areas.

Samples form a regular grid, n x n to a pixel (n = 1, 2, 4, 8). A triangle covers the samples inside it; a sample on an
edge belongs to one of the edge's two triangles by the top-left rule. Edge functions (Pineda 1988) are sums of products
of snapped coordinates, integers below 2^62, and never round. The nearest has the least packed depth and id.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import torch
from jaxtyping import Int64
from torch import Tensor

from cloak_core.core.view import Cull, Fragments, Screen, Visibility, Window
from cloak_core.core.visibility.compiled import backend
from cloak_core.core.visibility.cpu.areas import visible_areas
from cloak_core.core.visibility.projection import flatten
from cloak_core.core.visibility.screen import EMPTY, GRID, ID_BITS
from cloak_core.files.errors import InputError

MAX_TRIANGLES = 1 << (ID_BITS - 1)
"""Triangles of one body; ids are the low bits of the packed value and all ones mean "none"."""


def rasterize(
    screen: Screen,
    triangles: Int64[Tensor, "3 T"],
    grid: int = 1,
    cull: Cull = None,
    window: Window | None = None,
) -> Visibility:
    """Find the nearest triangle at every sample.

    triangles: vertex indices, corner by corner; counter-clockwise seen from the front.
    grid: n, for n * n samples per pixel: 1, 2, 4 or 8.
    cull: the triangles that are dropped where they show their back.
    window: the part of the image to work on; where absent, the bounding box of the bodies on the screen.

    Nothing is differentiable. Memory follows the window's samples plus a few arrays of `torch.sampling.CHUNK` elements.
    """
    if triangles.shape[1] > MAX_TRIANGLES:
        raise InputError(f"{triangles.shape[1]} triangles in one body; at most {MAX_TRIANGLES} can be told apart")
    if grid not in (1, 2, 4, 8):
        raise ValueError(f"grid {grid}: 1, 2, 4 or 8 samples along a pixel's side")
    window = window or bounding_window(screen)
    rows, columns = (window.y1 - window.y0) * grid, (window.x1 - window.x0) * grid
    packed = torch.full((len(screen.x), rows, columns), EMPTY, dtype=torch.int64, device=screen.x.device)
    if packed.numel():
        for view, own in enumerate(packed):
            flat = flatten(screen, triangles, view, cull)
            shift = (GRID // grid).bit_length() - 1
            backend(packed.device).cover(own, flat, window.y0 * grid, window.x0 * grid, shift)
    return Visibility(packed, window, screen.width, screen.height, grid)


def area_fragments(screen: Screen, triangles: Int64[Tensor, "3 T"], cull: Cull, window: Window) -> Fragments:
    """Find the fragments of one view by exact area, in closed form, without samples; on the CPU alone.

    Every triangle is cut by the pixels that it touches, and where pieces overlap, by the nearer ones. triangles, cull
    and window as for `rasterize`. Warns of `CrowdedPixels`.
    """
    flat = flatten(screen, triangles, 0, cull)
    return Fragments.join(visible_areas(flat, window, screen.width))


def merge_samples(visibility: Visibility) -> Fragments:
    """Merge the visible samples of every (pixel, triangle) of one view, lit at their mean position."""
    packed = visibility.packed[0]
    v = visibility
    return backend(packed.device).merge_samples(packed, v.grid, v.window, v.width)


def row_bands(screen: Screen, window: Window, count: int) -> list[Window]:
    """Cut a window into up to `count` bands of rows with about as many vertices each."""
    height = window.y1 - window.y0
    if count <= 1 or height < count or not screen.y.numel():
        return [window]
    rows = torch.histc((screen.y.float() / GRID).clamp(window.y0, window.y1), height, window.y0, window.y1).cumsum(0)
    shares = torch.arange(1, count, device=rows.device) * (rows[-1] / count)
    cuts = [window.y0 + 1 + cut for cut in torch.searchsorted(rows, shares).tolist()]
    edges = sorted({window.y0, *(min(cut, window.y1) for cut in cuts), window.y1})
    return [replace(window, y0=y0, y1=y1) for y0, y1 in itertools.pairwise(edges)]


def bounding_window(screen: Screen) -> Window:
    """Find the pixels that the batch can touch: the vertices' bounding box, or the image if any need clipping."""
    if screen.in_guard_band is not None:
        return Window(0, 0, screen.width, screen.height)
    x0, x1, y0, y1 = screen.bounds
    left, right = (min(max(at, 0), screen.width) for at in (x0 // GRID, x1 // GRID + 1))
    top, bottom = (min(max(at, 0), screen.height) for at in (y0 // GRID, y1 // GRID + 1))
    return Window(left, top, right, bottom)
