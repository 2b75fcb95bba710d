"""Triangles to the nearest triangle at every sample: exact coverage, any number of views at once, CPU and CUDA alike.

Samples form a regular grid, n x n to a pixel (n = 1, 2, 4, 8). A triangle covers the samples inside it; a sample on an
edge belongs to one of the edge's two triangles by the top-left rule. Edge functions are sums of products of snapped
coordinates, integers below 2^62, and never round. The nearest wins by the least key (visibility/keys.py).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import torch
from jaxtyping import Int32, Int64
from torch import Tensor

from cloak_core.files.errors import InputError
from cloak_core.render.seam import steps
from cloak_core.render.threads import even, spread
from cloak_core.render.visibility.flat import Cull, flatten
from cloak_core.render.visibility.keys import EMPTY, ID_BITS, triangle_ids
from cloak_core.render.visibility.projection import GRID, Screen, Window

MAX_TRIANGLES = 1 << (ID_BITS - 1)
"""Triangles of one body; ids are the low bits of a key and all ones mean "none"."""

Keys = Int64[Tensor, "B rows columns"]


@dataclass(frozen=True)
class Visibility:
    """The nearest triangle at every sample of a window of B views."""

    keys: Keys
    """Sample rows and columns, n to a pixel: depth above `ID_BITS` bits of triangle id; `EMPTY` where nothing is."""
    window: Window
    width: int
    height: int
    grid: int
    """Samples along each side of a pixel, n."""

    def triangles(self) -> Int32[Tensor, "B H W S"]:
        """Triangle id per sample of the whole image, S = n * n samples of a pixel row by row; -1 = none."""
        w, n = self.window, self.grid
        ids = triangle_ids(self.keys).to(torch.int32).view(len(self.keys), w.y1 - w.y0, n, w.x1 - w.x0, n)
        image = ids.new_full((len(ids), self.height, self.width, n * n), -1)
        image[:, w.y0 : w.y1, w.x0 : w.x1] = ids.transpose(2, 3).flatten(3)
        return image


def rasterize(
    screen: Screen,
    triangles: Int64[Tensor, "3 T"],
    grid: int = 1,
    cull: Cull = None,
    window: Window | None = None,
    workers: int = 1,
) -> Visibility:
    """The nearest triangle at every sample.

    triangles: vertex indices, corner by corner; counter-clockwise seen from the front.
    grid: n, for n * n samples per pixel: 1, 2, 4 or 8.
    cull: which triangles are dropped where they show their back.
    window: the part of the image to work on; where absent, the bounding box of the bodies on the screen.
    workers: CPU threads that share the views, or one view's rows.

    Nothing is differentiable. Memory follows the window's samples plus a few arrays of `samples.chunk_size` elements.
    """
    if triangles.shape[1] > MAX_TRIANGLES:
        raise InputError(f"{triangles.shape[1]} triangles in one body; at most {MAX_TRIANGLES} can be told apart")
    if grid not in (1, 2, 4, 8):
        raise ValueError(f"grid {grid}: 1, 2, 4 or 8 samples along a pixel's side")
    window = window or bounding_window(screen)
    rows, columns = (window.y1 - window.y0) * grid, (window.x1 - window.x0) * grid
    keys = torch.full((len(screen.x), rows, columns), EMPTY, dtype=torch.int64, device=screen.x.device)

    def cover_part(part: tuple[slice, Window]) -> None:
        views, band = part
        own = keys[views, (band.y0 - window.y0) * grid : (band.y1 - window.y0) * grid]
        culled = None if cull is None else cull[views]
        _cover(own, screen.part(views), triangles, band, grid, culled)

    if keys.numel():
        if len(keys) > 1:
            parts = [(views, window) for views in even(len(keys), workers)]
        else:
            parts = [(slice(0, 1), band) for band in row_bands(screen, window, workers)]
        spread(cover_part, parts, workers)
    return Visibility(keys, window, screen.width, screen.height, grid)


def _cover(
    keys: Keys,
    screen: Screen,
    triangles: Int64[Tensor, "3 T"],
    band: Window,
    grid: int,
    cull: Cull,
) -> None:
    shift = (GRID // grid).bit_length() - 1
    for view, own in enumerate(keys):
        flat = flatten(screen, triangles, view, cull)
        steps(keys.device).cover(own, flat, band.y0 * grid, band.x0 * grid, shift)


def row_bands(screen: Screen, window: Window, count: int) -> list[Window]:
    """A window cut into up to `count` bands of rows with about as many vertices each."""
    height = window.y1 - window.y0
    if count <= 1 or height < count or not screen.y.numel():
        return [window]
    rows = torch.histc((screen.y.float() / GRID).clamp(window.y0, window.y1), height, window.y0, window.y1).cumsum(0)
    shares = torch.arange(1, count, device=rows.device) * (rows[-1] / count)
    cuts = [window.y0 + 1 + cut for cut in torch.searchsorted(rows, shares).tolist()]
    edges = sorted({window.y0, *(min(cut, window.y1) for cut in cuts), window.y1})
    return [replace(window, y0=y0, y1=y1) for y0, y1 in itertools.pairwise(edges)]


def bounding_window(screen: Screen) -> Window:
    """The pixels that the batch can touch: the bounding box of all vertices, or the image where some need clipping."""
    if screen.safe is not None:
        return Window(0, 0, screen.width, screen.height)
    x0, x1, y0, y1 = screen.bounds
    left, right = (min(max(at, 0), screen.width) for at in (x0 // GRID, x1 // GRID + 1))
    top, bottom = (min(max(at, 0), screen.height) for at in (y0 // GRID, y1 // GRID + 1))
    return Window(left, top, right, bottom)
