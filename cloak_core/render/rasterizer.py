"""Triangles to the nearest triangle at every sample: exact coverage, any number of views at once, CPU and CUDA alike.

Samples form a regular grid, n x n to a pixel (n = 1, 2, 4, 8). A triangle covers the samples inside it; a sample on an
edge belongs to one of the edge's two triangles by the top-left rule. Edge functions are sums of products of snapped
coordinates, so they are integers, and every step here evaluates them exactly: in float64 while all values stay below
2^53, in int64 for larger triangles.

The work shrinks from step to step. Most triangles of a body are smaller than a pixel, so first those go whose bounding
box holds no sample (a few int32 operations), then the back faces; what is left is cut into rows of samples, each row
into the run of samples between its left and right edge (one exact division for each edge), and only samples that are
truly covered are ever touched. The nearest wins by one scatter-minimum over keys that hold depth and triangle.

Depth is one number per sample, a 39-bit integer: trunc(nearness * 2^39), where nearness = n0 + (e1 * (n1 - n0) / A +
e2 * (n2 - n0) / A) in float64, corner 0 being the one with the smallest (x, y). It does not depend on the order of a
triangle's corners, so identical triangles tie, and ties go to the lower triangle.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int32, Int64
from torch import Tensor

from cloak_core.errors import InputError
from cloak_core.render.clipping import Soup, clip
from cloak_core.render.projection import GRID, Screen

ID_BITS = 24
DEPTH_BITS = 39
MAX_TRIANGLES = 1 << (ID_BITS - 1)
"""Triangles of one body; ids are the low bits of a key and all ones mean "none"."""
EMPTY = torch.iinfo(torch.int64).max
CHUNK = 1 << 18
"""Triangles, rows or samples worked on at once: enough to amortise an operation, small enough for the cache."""
_EXACT_EXTENT = 1 << 25
"""Snapped extent up to which edge functions are exact in float64: products stay below 2^50."""
_FAR = float(1 << 40)
_TINY = 1e-300


@dataclass(frozen=True)
class Window:
    """The part of the image that is rasterized, in pixels: columns x0 <= x < x1, rows y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int


@dataclass(frozen=True)
class Visibility:
    """The nearest triangle at every sample of a window of B views."""

    keys: Int64[Tensor, "B rows columns"]
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
) -> Visibility:
    """The nearest triangle at every sample.

    triangles: vertex indices, corner by corner; counter-clockwise seen from the front.
    grid: n, for n * n samples per pixel: 1, 2, 4 or 8.
    cull: views in which triangles that show their back are dropped; none where absent.
    window: the part of the image to work on; where absent, the bounding box of the bodies on the screen.

    Nothing is differentiable. Memory follows the window's samples plus a few arrays of `CHUNK` elements.
    """
    if triangles.shape[1] > MAX_TRIANGLES:
        raise InputError(f"{triangles.shape[1]} triangles in one body; at most {MAX_TRIANGLES} can be told apart")
    if grid not in (1, 2, 4, 8):
        raise ValueError(f"grid {grid}: 1, 2, 4 or 8 samples along a pixel's side")
    window = window or bounding_window(screen)
    rows, columns = (window.y1 - window.y0) * grid, (window.x1 - window.x0) * grid
    keys = torch.full((len(screen.x), rows, columns), EMPTY, dtype=torch.int64, device=screen.x.device)
    raster = _Raster(keys, window, grid, cull)
    if keys.numel():
        for soup, view, ids in _candidates(screen, triangles, raster):
            raster.add(soup, view, ids)
    return Visibility(keys, window, screen.width, screen.height, grid)


def bounding_window(screen: Screen) -> Window:
    """The pixels that the batch can touch: the bounding box of all vertices, or the image where some need clipping."""
    whole = Window(0, 0, screen.width, screen.height)
    if not screen.x.numel():
        return Window(0, 0, 0, 0)
    lowest = lambda t: torch.aminmax(t)
    (x0, x1), (y0, y1) = lowest(screen.x), lowest(screen.y)
    x0, x1, y0, y1, safe = torch.stack([x0, x1, y0, y1, screen.safe.all().to(torch.int32)]).tolist()
    if not safe:
        return whole
    clamp = lambda value, limit: min(max(value, 0), limit)
    left, right = clamp(x0 // GRID, whole.x1), clamp(x1 // GRID + 1, whole.x1)
    top, bottom = clamp(y0 // GRID, whole.y1), clamp(y1 // GRID + 1, whole.y1)
    return Window(left, top, max(left, right), max(top, bottom))


def _candidates(
    screen: Screen, triangles: Int64[Tensor, "3 T"], raster: _Raster
) -> Iterator[tuple[Soup, Int64[Tensor, " N"], Int64[Tensor, " N"]]]:
    """Snapped triangles whose box holds a sample, chunk by chunk, with their view and id; clipped where needed."""
    batch, vertex_count = screen.x.shape
    x, y, nearness = screen.x.view(-1), screen.y.view(-1), screen.nearness.view(-1)
    unsafe = ~screen.safe.view(-1) if not bool(screen.safe.all()) else None
    size = max(1, CHUNK // batch)
    base = torch.arange(batch, device=x.device).unsqueeze(-1) * vertex_count
    for start in range(0, triangles.shape[1], size):
        corner = (triangles[:, start : start + size].unsqueeze(1) + base).view(3, -1)
        per_view = corner.shape[1] // batch
        # int32 and one flat gather for each coordinate: this is where every triangle is touched.
        cx, cy = (t.index_select(0, corner.view(-1)).view(3, -1) for t in (x, y))
        keep = raster.holds_samples(cx, cy)
        if unsafe is not None:
            cut = unsafe.index_select(0, corner.view(-1)).view(3, -1).any(0)
            keep &= ~cut
            yield from _clipped(screen, corner, cut, per_view, start)
        index = keep.nonzero().view(-1)
        corner = corner.index_select(1, index)
        view = torch.div(index, per_view, rounding_mode="floor") if batch > 1 else torch.zeros_like(index)
        soup = Soup(cx[:, index], cy[:, index], nearness[corner])
        yield soup, view, index - view * per_view + start


def _clipped(
    screen: Screen, corner: Int64[Tensor, "3 N"], cut: Bool[Tensor, " N"], per_view: int, start: int
) -> Iterator[tuple[Soup, Int64[Tensor, " M"], Int64[Tensor, " M"]]]:
    index = cut.nonzero().view(-1)
    if not len(index):
        return
    view = torch.div(index, per_view, rounding_mode="floor")
    corners = screen.view.reshape(3, -1)[:, corner[:, index]].transpose(0, 1)
    focal, near = screen.focal.view(-1)[view], screen.near.view(-1)[view]
    soup, owner = clip(corners, focal, near, screen.width, screen.height)
    yield soup, view[owner], index[owner] - view[owner] * per_view + start


class _Raster:
    """The samples being filled."""

    def __init__(self, keys: Int64[Tensor, "B rows columns"], window: Window, grid: int, cull: Tensor | None) -> None:
        self.flat_keys = keys.view(-1)
        self.rows, self.columns = keys.shape[1:]
        self.cull = cull
        self.step = GRID // grid
        self.shift = self.step.bit_length() - 1
        self.column0, self.row0 = window.x0 * grid, window.y0 * grid

    def span(
        self, low: Int32[Tensor, "*N"], high: Int32[Tensor, "*N"], first: int, count: int
    ) -> tuple[Tensor, Tensor]:
        """First and last sample (of `count` from `first` on) at snapped positions within [low, high]."""
        half = self.step // 2
        lowest = (low + (half - 1)) >> self.shift  # ceil((low - half) / step)
        highest = (high - half) >> self.shift
        return lowest.clamp_(min=first), highest.clamp_(max=first + count - 1)

    def holds_samples(self, x: Int32[Tensor, "3 N"], y: Int32[Tensor, "3 N"]) -> Bool[Tensor, " N"]:
        """Whether the bounding box contains any sample of the window."""
        c0, c1 = self.span(_minimum(x), _maximum(x), self.column0, self.columns)
        r0, r1 = self.span(_minimum(y), _maximum(y), self.row0, self.rows)
        return (c0 <= c1) & (r0 <= r1)

    def add(self, soup: Soup, view: Int64[Tensor, " N"], ids: Int64[Tensor, " N"]) -> None:
        """Let triangles compete for the samples they cover."""
        x, y, nearness = canonical(soup)
        extent = torch.maximum(_maximum(x) - _minimum(x), _maximum(y) - _minimum(y))
        large = extent >= _EXACT_EXTENT
        keep = self._faces_camera(x, y, view)
        for exact, chosen in ((torch.float64, keep & ~large), (torch.int64, keep & large)):
            index = chosen.nonzero().view(-1)
            if not len(index):
                continue
            pick = lambda t, i=index: t.index_select(-1, i)
            setup = _Setup.build(self, pick(x), pick(y), pick(nearness), pick(view), pick(ids), exact)
            for rows in setup.rows():
                for samples, keys in rows.samples():
                    self.flat_keys.scatter_reduce_(0, samples, keys, "amin")

    def _faces_camera(self, x: Int32[Tensor, "3 N"], y: Int32[Tensor, "3 N"], view: Int64[Tensor, " N"]) -> Tensor:
        """Not degenerate, and turned to the camera wherever back faces are dropped."""
        area = doubled_area(x.to(torch.int64), y.to(torch.int64))
        if self.cull is None:
            return area != 0
        # The screen's y points down: the front is clockwise on it, which is a negative area.
        return (area < 0) | ((area > 0) & ~self.cull[view])


def canonical(soup: Soup) -> tuple[Tensor, Tensor, Tensor]:
    """Corners rotated so that the one with the smallest (x, y) comes first: (x, y, nearness), each [3, N]."""
    order = (soup.x.to(torch.int64) << 32) + soup.y
    first = (order[1] < order[0]).to(torch.int64)
    first = torch.where(order[2] < torch.minimum(order[0], order[1]), 2, first)
    corner = torch.arange(3, device=first.device).unsqueeze(-1)
    rotation = (corner + first) % 3
    return soup.x.gather(0, rotation), soup.y.gather(0, rotation), soup.nearness.gather(0, rotation)


def doubled_area(x: Tensor, y: Tensor) -> Tensor:
    """Twice the signed area of triangles given corner by corner; positive where clockwise on a screen with y down."""
    return (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])


@dataclass(frozen=True)
class _Setup:
    """N triangles ready for covering: edge functions at the first sample of their box, and their steps.

    Edge function i is A at corner i, 0 on the opposite edge and positive inside; their sum is A everywhere. Corner 0's
    follows from the other two. Tensors are [N]; `edge`, `across`, `down` are tuples over the three corners.
    """

    raster: _Raster
    edge: tuple[Tensor, Tensor, Tensor]
    across: tuple[Tensor, Tensor, Tensor]
    """Change of the edge function from one sample column to the next; never 0, see `_no_zero`."""
    down: tuple[Tensor, Tensor, Tensor]
    slope: tuple[Tensor, Tensor]
    """(n1 - n0) / A and (n2 - n0) / A, float64."""
    nearness: Tensor
    width: Tensor
    """Sample columns of the box."""
    height: Tensor
    first: Tensor
    """Flat index of the box's first sample."""
    ids: Tensor

    @staticmethod
    def build(
        raster: _Raster, x: Tensor, y: Tensor, nearness: Tensor, view: Tensor, ids: Tensor, exact: torch.dtype
    ) -> _Setup:
        """Triangles in canonical corner order; `exact` is the type in which their edge functions do not round."""
        c0, c1 = raster.span(_minimum(x), _maximum(x), raster.column0, raster.columns)
        r0, r1 = raster.span(_minimum(y), _maximum(y), raster.row0, raster.rows)
        x, y = x.to(exact), y.to(exact)
        d1x, d1y, d2x, d2y = x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0]
        area = d1x * d2y - d1y * d2x
        sign = torch.sign(area)
        area = area * sign
        a1, b1, a2, b2 = sign * d2y, -sign * d2x, -sign * d1y, sign * d1x
        step, half = raster.step, raster.step // 2
        right, below = c0.to(exact) * step + half - x[0], r0.to(exact) * step + half - y[0]
        e1, e2 = a1 * right + b1 * below, a2 * right + b2 * below
        real_area = area.to(torch.float64)
        first = (view * raster.rows + (r0 - raster.row0)) * raster.columns + (c0 - raster.column0)
        return _Setup(
            raster,
            edge=(area - e1 - e2, e1, e2),
            across=(-(a1 + a2) * step, a1 * step, a2 * step),
            down=(-(b1 + b2) * step, b1 * step, b2 * step),
            slope=((nearness[1] - nearness[0]) / real_area, (nearness[2] - nearness[0]) / real_area),
            nearness=nearness[0],
            width=(c1 - c0 + 1).clamp_(min=0),
            height=(r1 - r0 + 1).clamp_(min=0),
            first=first,
            ids=ids,
        )

    def rows(self) -> Iterator[_Rows]:
        """Every row of samples of every box, with the run of samples that lies inside the triangle."""
        for owner, offset in _expand(self.height):
            pick = lambda t, o=owner: t.index_select(0, o)
            down = offset.to(self.edge[0].dtype)
            edge = [pick(e) + down * pick(d) for e, d in zip(self.edge, self.down, strict=True)]
            low, high = torch.zeros_like(edge[0]), pick(self.width).to(edge[0].dtype)
            across = [pick(a) for a in self.across]
            for e, a, d in zip(edge, across, self.down, strict=True):
                low, high = _narrow(low, high, e, a, pick(d))
            first = pick(self.first) + offset * self.raster.columns
            yield _Rows(self, owner, tuple(edge[1:]), tuple(across[1:]), low, high - low, first)


def _narrow(low: Tensor, high: Tensor, edge: Tensor, across: Tensor, down: Tensor) -> tuple[Tensor, Tensor]:
    """Cut a row's run [low, high) of columns k to where edge + k * across is inside, the top-left rule included.

    A left edge (across > 0) owns its samples: k >= -edge / across. A right edge (across < 0) does not:
    k < -edge / across. Both bounds are the quotient rounded up, and it is exact: float64 rounds a quotient of integers
    whose sizes add up to less than 2^53 to a whole number only where it is one. Along a level edge nothing changes from
    column to column: the top edge (down > 0) owns its samples and the bottom edge does not.
    """
    if edge.dtype == torch.float64:
        left = torch.where(across == 0, down, across) > 0
        level = torch.full_like(edge, _TINY).copysign_(down)
        bound = -torch.floor(edge / torch.where(across == 0, level, across))
    else:
        level = across == 0
        left = torch.where(level, down, across) > 0
        inside = torch.where(left, edge >= 0, edge > 0)
        bound = -torch.div(edge, torch.where(level, 1, across), rounding_mode="floor")
        bound = torch.where(level, torch.where(inside == left, -int(_FAR), int(_FAR)), bound)
    return torch.where(left, torch.maximum(low, bound), low), torch.where(left, high, torch.minimum(high, bound))


@dataclass(frozen=True)
class _Rows:
    """R rows of samples, each with its covered run: columns low to low + count of its triangle's box."""

    setup: _Setup
    owner: Tensor
    edge: tuple[Tensor, Tensor]
    across: tuple[Tensor, Tensor]
    low: Tensor
    count: Tensor
    first: Tensor

    def samples(self) -> Iterator[tuple[Int64[Tensor, " M"], Int64[Tensor, " M"]]]:
        """Flat index and key of every covered sample."""
        setup = self.setup
        for row, offset in _expand(self.count.clamp(min=0).to(torch.int64)):
            pick = lambda t, r=row: t.index_select(0, r)
            column = pick(self.low) + offset
            e1, e2 = (
                (pick(e) + column * pick(a)).to(torch.float64) for e, a in zip(self.edge, self.across, strict=True)
            )
            owner = pick(self.owner)
            own = lambda t, o=owner: t.index_select(0, o)
            nearness = own(setup.nearness) + (e1 * own(setup.slope[0]) + e2 * own(setup.slope[1]))
            depth = (nearness * (1 << DEPTH_BITS)).to(torch.int64).clamp_(0, (1 << DEPTH_BITS) - 1)
            keys = ((((1 << DEPTH_BITS) - 1) - depth) << ID_BITS) | own(setup.ids)
            yield pick(self.first) + column.to(torch.int64), keys


def _expand(counts: Tensor) -> Iterator[tuple[Int64[Tensor, " M"], Int64[Tensor, " M"]]]:
    """Each index i counts[i] times, with its offset 0 .. counts[i] - 1, in pieces of about `CHUNK` elements."""
    if not len(counts):
        return
    counts = counts.to(torch.int64)
    ends = counts.cumsum(0)
    total = int(ends[-1])
    cuts = [0, len(counts)]
    if total > CHUNK:
        inner = torch.searchsorted(ends, torch.arange(CHUNK, total, CHUNK, device=ends.device))
        cuts = sorted({0, *inner.tolist(), len(counts)})
    for start, stop in itertools.pairwise(cuts):
        part = counts[start:stop]
        before = int(ends[start - 1]) if start else 0
        length = (int(ends[stop - 1]) if stop < len(counts) else total) - before
        if length:
            owner = torch.repeat_interleave(part, output_size=length)
            starts = ends[start:stop] - part - before
            yield owner + start, torch.arange(length, device=owner.device) - starts.index_select(0, owner)


def _minimum(corners: Tensor) -> Tensor:
    return torch.minimum(torch.minimum(corners[0], corners[1]), corners[2])


def _maximum(corners: Tensor) -> Tensor:
    return torch.maximum(torch.maximum(corners[0], corners[1]), corners[2])
