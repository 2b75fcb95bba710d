"""Triangles to the nearest triangle at every sample: exact coverage, any number of views at once, CPU and CUDA alike.

Samples form a regular grid, n x n to a pixel (n = 1, 2, 4, 8). A triangle covers the samples inside it; a sample on an
edge belongs to one of the edge's two triangles by the top-left rule. Edge functions are sums of products of snapped
coordinates, so they are integers, and every step here evaluates them exactly: in float64 while all values stay below
2^53, in int64 for larger triangles.

The work shrinks from step to step. Most triangles of a body are smaller than a pixel, so first those go whose bounding
box holds no sample (a few int32 operations), then the back faces; what is left is cut into rows of samples, each row
into the run of samples between its left and right edge (one exact division for each edge), and only samples that are
truly covered are ever touched. The nearest wins by one scatter-minimum over keys that hold depth and triangle.

Depth is one number per sample, a 39-bit integer: trunc(nearness * 2^39), where nearness = (e1 * ((n1 - n0) / A) + e2 *
((n2 - n0) / A)) + n0 in float64. Corner 0 is the topmost one (of two the right one), corners 1 and 2 follow clockwise
on the screen, ei is the edge function that is A at corner i. It does not depend on the order in which a triangle lists
its corners, so identical triangles tie, and ties go to the lower triangle.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Int32, Int64
from torch import Tensor

from cloak_core.files.errors import InputError
from cloak_core.render.candidates import EXACT_EXTENT, Candidates, SampleGrid, Soup, Window, find_candidates
from cloak_core.render.clipping import clip
from cloak_core.render.compiled import use_loops
from cloak_core.render.covering import DEPTH_BITS, ID_BITS, Setup, chunk_size
from cloak_core.render.covering_loops import EMPTY
from cloak_core.render.covering_loops import cover as cover_by_loops
from cloak_core.render.flat import flatten
from cloak_core.render.projection import GRID, Screen
from cloak_core.render.threads import even, spread

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


def triangle_ids(keys: Int64[Tensor, "*N"]) -> Int64[Tensor, "*N"]:
    """Triangle of each key, -1 for `EMPTY`."""
    return (keys << (64 - ID_BITS)) >> (64 - ID_BITS)


def inverse_depth(keys: Int64[Tensor, "*N"]) -> Tensor:
    """Near plane over view z of each key, float64 in [0, 1] (truncated to `DEPTH_BITS` bits)."""
    return ((1 << DEPTH_BITS) - 1 - (keys >> ID_BITS)).to(torch.float64) / (1 << DEPTH_BITS)


def rasterize(
    screen: Screen,
    triangles: Int64[Tensor, "3 T"],
    grid: int = 1,
    cull: Bool[Tensor, " B"] | None = None,
    window: Window | None = None,
    workers: int = 1,
) -> Visibility:
    """The nearest triangle at every sample.

    triangles: vertex indices, corner by corner; counter-clockwise seen from the front.
    grid: n, for n * n samples per pixel: 1, 2, 4 or 8.
    cull: views in which triangles that show their back are dropped; none where absent.
    window: the part of the image to work on; where absent, the bounding box of the bodies on the screen.
    workers: CPU threads that share the views, or one view's rows.

    Nothing is differentiable. Memory follows the window's samples plus a few arrays of `covering.chunk_size` elements.
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
        cover = _cover_by_loops if use_loops(keys.device) else _cover
        cover(own, screen.part(views), triangles, SampleGrid(band, grid), culled)

    if keys.numel():
        if len(keys) > 1:
            parts = [(views, window) for views in even(len(keys), workers)]
        else:
            parts = [(slice(0, 1), band) for band in row_bands(screen, window, workers)]
        spread(cover_part, parts, workers)
    return Visibility(keys, window, screen.width, screen.height, grid)


def _cover_by_loops(
    keys: Keys, screen: Screen, triangles: Int64[Tensor, "3 T"], samples: SampleGrid, cull: Bool[Tensor, " B"] | None
) -> None:
    for view, own in enumerate(keys.numpy()):
        culled = cull is not None and bool(cull[view])
        flat = flatten(screen, triangles, view).arrays()
        cover_by_loops(own, *flat, culled, samples.row0, samples.column0, samples.shift)


def _cover(
    keys: Keys, screen: Screen, triangles: Int64[Tensor, "3 T"], samples: SampleGrid, cull: Bool[Tensor, " B"] | None
) -> None:
    for chunk in candidates(screen, triangles, samples, cull):
        first = samples.first(chunk.found.box, chunk.view)
        setup = Setup.build(samples.step, samples.columns, chunk.soup, chunk.found, first, chunk.ids, chunk.exact)
        for rows in setup.rows():
            for index, key in rows.hits():
                keys.view(-1).scatter_reduce_(0, index, key, "amin")


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
    clamp = lambda value, limit: min(max(value, 0), limit)
    left, right = clamp(x0 // GRID, screen.width), clamp(x1 // GRID + 1, screen.width)
    top, bottom = clamp(y0 // GRID, screen.height), clamp(y1 // GRID + 1, screen.height)
    return Window(left, top, right, bottom)


@dataclass(frozen=True)
class Chunk:
    """Some candidates of a soup: M triangles that may matter, whose edge functions are exact in `exact`."""

    soup: Soup
    found: Candidates
    view: Int64[Tensor, " M"] | None
    """None: there is only one."""
    ids: Int64[Tensor, " M"]
    exact: torch.dtype


def candidates(
    screen: Screen, triangles: Int64[Tensor, "3 T"], grid: SampleGrid, cull: Bool[Tensor, " B"] | None
) -> Iterator[Chunk]:
    """All triangles, clipped where they must be, that have area, are not culled and whose box meets the grid."""
    batch, vertex_count = screen.x.shape
    x0, x1, y0, y1 = screen.bounds
    small = screen.safe is None and max(x1 - x0, y1 - y0) < EXACT_EXTENT
    size = max(1, chunk_size(triangles.device) // batch)
    base = torch.arange(batch, device=triangles.device).unsqueeze(-1) * vertex_count
    culled = [False] if cull is None else cull.tolist()
    culled = culled[0] if len(set(culled)) == 1 else cull.to(triangles.device)
    for start in range(0, triangles.shape[1], size):
        corner = triangles[:, start : start + size]
        if batch > 1:
            corner = (corner.unsqueeze(1) + base).view(3, -1)
        per_view = corner.shape[1] // batch
        soup = Soup(_at(screen.x, corner), _at(screen.y, corner), corner, screen.nearness.view(-1))
        cut = None if screen.safe is None else ~_at(screen.safe, corner).all(0)
        back = culled if isinstance(culled, bool) else culled.repeat_interleave(per_view)
        for found, exact in find_candidates(grid, soup, back, cut, small):
            yield Chunk(soup, found, *_identify(found.index, per_view, batch, start), exact)
        if cut is not None:
            index = cut.nonzero().view(-1)
            view = torch.div(index, per_view, rounding_mode="floor")
            soup, owner = _clipped(screen, corner.index_select(1, index), view)
            back = culled if isinstance(culled, bool) else culled[view[owner]]
            for found, exact in find_candidates(grid, soup, back, None, False):
                where = index[owner[found.index]]
                yield Chunk(soup, found, *_identify(where, per_view, batch, start), exact)


def _identify(index: Tensor, per_view: int, batch: int, start: int) -> tuple[Tensor | None, Tensor]:
    """View (None: the only one) and id of triangles, from their place in a chunk."""
    if batch == 1:
        return None, index + start
    view = torch.div(index, per_view, rounding_mode="floor")
    return view, index - view * per_view + start


def _clipped(
    screen: Screen, corner: Int64[Tensor, "3 N"], view: Int64[Tensor, " N"]
) -> tuple[Soup, Int64[Tensor, " M"]]:
    corners = torch.stack([_at(axis, corner) for axis in screen.view], 1)
    focal, near = screen.focal.view(-1).index_select(0, view), screen.near.view(-1).index_select(0, view)
    return clip(corners, focal, near, screen.width, screen.height)


def _at(values: Tensor, corner: Int64[Tensor, "3 N"]) -> Tensor:
    """values[corner] by one flat gather, the fastest there is on the CPU."""
    return values.reshape(-1).index_select(0, corner.reshape(-1)).view(corner.shape)
