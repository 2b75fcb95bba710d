"""Fragments by exact area: how much of each pixel each triangle covers.

Most triangles of a body are smaller than a pixel, and samples miss many of them altogether. So every candidate triangle
is cut by the pixels that it touches, in closed form (float64). In a pixel whose pieces add up to exactly one pixel
nothing overlaps and all of them are seen: their areas are the answer. Only in doubtful pixels, along silhouettes and
folds, the pieces compete at samples of the pixel (competition.py).
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Bool, Float32, Float64, Int64
from torch import Tensor

from cloak_core.render import area_loops
from cloak_core.render.area_loops import NOTHING
from cloak_core.render.candidates import PixelGrid, Window
from cloak_core.render.competition import Pieces, Triangles, seen_share
from cloak_core.render.compiled import use_loops
from cloak_core.render.covering import expand
from cloak_core.render.flat import flatten
from cloak_core.render.fragments import Fragments, Points
from cloak_core.render.projection import GRID, Screen
from cloak_core.render.rasterizer import Chunk, candidates

_TINY = 1e-30
_EDGES = ((0, 1), (1, 2), (2, 0))


def area_fragments(
    screen: Screen, triangles: Int64[Tensor, "3 T"], cull: Bool[Tensor, " B"] | None, window: Window
) -> Fragments:
    """Fragments whose area is the exact overlap of triangle and pixel, times the share of it that is seen.

    triangles, cull and window as for `rasterizer.rasterize`.
    """
    if use_loops(screen.x.device):
        views = [_by_loops(screen, triangles, cull, window, view) for view in range(len(screen.x))]
        return views[0] if len(views) == 1 else _joined(views)
    found, parts, count = [], [], 0
    for chunk in candidates(screen, triangles, PixelGrid(window), cull):
        parts += _pieces(chunk, screen, count)
        found.append(_triangles(chunk))
        count += len(chunk.ids)
    if not parts:
        return _nothing(screen.x.device)
    tri, pieces = Triangles.join(found), Pieces.join(parts)
    # int32: the only kind of sort that is fast on the CPU.
    places = len(screen.x) * screen.width * screen.height
    key = pieces.place.to(torch.int32) if places < 1 << 31 else pieces.place
    pieces = pieces.take(torch.sort(key, stable=True).indices)
    area = pieces.area * seen_share(pieces, tri, screen, window)
    return _fragments(pieces.take(kept := (area > NOTHING).nonzero().view(-1)), area[kept], tri, screen)


def _by_loops(
    screen: Screen, triangles: Int64[Tensor, "3 T"], cull: Bool[Tensor, " B"] | None, window: Window, view: int
) -> Fragments:
    flat, culled = flatten(screen, triangles, view), cull is not None and bool(cull[view])
    edges = window.x0, window.x1, window.y0, window.y1
    found = area_loops.fragments(*flat.arrays(), culled, *edges, screen.width, float(screen.focal[view]))
    pixel, triangle, area, center, offset = map(torch.from_numpy, found)
    of = torch.full_like(pixel, view)
    return Fragments(of, pixel, triangle, area, Points(of, triangle, *center), None, offset)


def _joined(views: list[Fragments]) -> Fragments:
    join = lambda name: torch.cat([getattr(view, name) for view in views], -1)
    of, triangle = join("view"), join("triangle")
    center = (torch.cat([getattr(view.points, axis) for view in views]) for axis in "xy")
    return Fragments(of, join("pixel"), triangle, join("area"), Points(of, triangle, *center), None, join("offset"))


def _triangles(chunk: Chunk) -> Triangles:
    soup, found = chunk.soup, chunk.found
    at = lambda t: torch.stack([row.index_select(0, found.index) for row in t])
    nearness = soup.nearness.index_select(0, at(soup.corner).view(-1)).view(3, -1)
    view = torch.zeros_like(chunk.ids) if chunk.view is None else chunk.view
    large = torch.full_like(found.clockwise, chunk.exact == torch.int64)
    return Triangles(view, chunk.ids, at(soup.x), at(soup.y), nearness, found.clockwise, large)


def _pieces(chunk: Chunk, screen: Screen, before: int) -> Iterator[Pieces]:
    """All overlaps of a chunk's triangles with pixels; `before` triangles came in earlier chunks."""
    c0, c1, r0, r1 = chunk.found.box
    relative = lambda t, first: [
        row.index_select(0, chunk.found.index).sub_(first * GRID).to(torch.float64).div_(GRID) for row in t
    ]
    x, y = relative(chunk.soup.x, c0), relative(chunk.soup.y, r0)
    place = r0.to(torch.int64).mul_(screen.width).add_(c0)
    if chunk.view is not None:
        place += chunk.view * (screen.width * screen.height)
    for owner, down, across, area in overlaps(x, y, c1 - c0 + 1, r1 - r0 + 1):
        keep = (area > NOTHING).nonzero().view(-1)
        owner, down, across, area = (t.index_select(0, keep) for t in (owner, down, across, area))
        yield Pieces(down.mul_(screen.width).add_(across).add_(place.index_select(0, owner)), owner.add_(before), area)


def overlaps(
    x: list[Tensor], y: list[Tensor], width: Tensor, height: Tensor
) -> Iterator[tuple[Int64[Tensor, " P"], Int64[Tensor, " P"], Int64[Tensor, " P"], Float64[Tensor, " P"]]]:
    """Areas that triangles share with the unit squares of a box each, in batches: owner, row, column, area.

    x, y: corners, float64 [N] each, from the top left corner of the triangle's box of width x height squares.

    By Green's theorem a polygon's part to the left of x = c has the area of the integral of min(x, c) dy around it. In
    each row of squares, every edge contributes the height that it spans there times the mean of min(x, c) along it.
    """
    slope = [(x[j] - x[i]) / (y[j] - y[i]).masked_fill_(y[j] == y[i], 1) for i, j in _EDGES]
    cut = bool((torch.minimum(torch.minimum(x[0], x[1]), x[2]) < 0).any())
    wide = width.to(torch.int64)
    for owner, down in expand(height.to(torch.int64)):
        edges, whole = _edges_in_row(x, y, slope, owner, down)
        for row, across in expand(wide.index_select(0, owner)):
            area = _left_of(edges, whole, row, (across + 1).to(torch.float64))
            first = across.clamp(max=1).to(torch.float64)  # 0 in the first column, else 1
            before = first[1:] * area[:-1]
            if cut:
                edge = (across == 0).nonzero().view(-1)
                outside = _left_of(edges, whole, row.index_select(0, edge), area.new_zeros(len(edge)))
                area.index_add_(0, edge, outside, alpha=-1)
            area[1:] -= before
            yield owner.index_select(0, row), down.index_select(0, row), across, area.abs_()


def _edges_in_row(
    x: list[Tensor], y: list[Tensor], slope: list[Tensor], owner: Tensor, down: Tensor
) -> tuple[list[tuple[Tensor, Tensor, Tensor, Tensor]], Float64[Tensor, " R"]]:
    """Every edge within a row of squares: its greatest x, the span of its x, its height and that over twice the span;
    and the integral of x dy over all of them."""
    y = [t.index_select(0, owner).sub_(down) for t in y]
    inner = [t.clamp(0, 1) for t in y]
    edges, whole = [], torch.zeros_like(y[0])
    for (i, j), lean in zip(_EDGES, slope, strict=True):
        start, lean = x[i].index_select(0, owner), lean.index_select(0, owner)
        a = (inner[i] - y[i]).mul_(lean).add_(start)
        b = (inner[j] - y[i]).mul_(lean).add_(start)
        rise, high = inner[j] - inner[i], torch.maximum(a, b)
        span = high - torch.minimum(a, b)
        whole.add_(a.add_(b).mul_(rise))
        edges.append((high, span, rise, rise / (span * 2).clamp_(min=_TINY)))
    return edges, whole.mul_(0.5)


def _left_of(edges: list[tuple[Tensor, ...]], whole: Tensor, row: Tensor, c: Float64[Tensor, " P"]) -> Tensor:
    """Area of a triangle's part in its row that lies to the left of x = c, negative where it turns the other way."""
    area = whole.index_select(0, row)
    for high, span, rise, share in edges:
        # mean of min(x, c) = mean of x - mean of max(x - c, 0); the latter is a triangle where c is between, and more
        # where it is beyond.
        reach = high.index_select(0, row).sub_(c).clamp_(min=0)
        within = torch.minimum(reach, span.index_select(0, row))
        area.sub_(reach.sub_(within).mul_(rise.index_select(0, row)))
        area.sub_(within.square_().mul_(share.index_select(0, row)))
    return area


def _fragments(pieces: Pieces, area: Float64[Tensor, " N"], tri: Triangles, screen: Screen) -> Fragments:
    """Every piece is lit where it lies."""
    used = torch.zeros_like(tri.large).index_fill_(0, pieces.owner, True)
    index = used.nonzero().view(-1)
    facet = used.cumsum(0).sub_(1).index_select(0, pieces.owner)
    x, y = (torch.stack([row.index_select(0, index) for row in t]).to(torch.float64).div_(GRID) for t in (tri.x, tri.y))
    facets = Points(tri.view.index_select(0, index), tri.ids.index_select(0, index), x.mean(0), y.mean(0))
    row = torch.div(pieces.place, screen.width, rounding_mode="floor")
    column = pieces.place - row * screen.width
    view = facets.view.index_select(0, facet)
    pixel = pieces.place - view * (screen.width * screen.height)
    row = row - view * screen.height
    offset = [_offset(*args, facet) for args in ((x, facets.x, column), (y, facets.y, row))]
    triangle = facets.triangle.index_select(0, facet)
    return Fragments(view, pixel, triangle, area.float(), facets, facet, torch.stack(offset))


def _offset(
    position: Float64[Tensor, "3 M"], center: Float64[Tensor, " M"], pixel: Int64[Tensor, " N"], facet: Tensor
) -> Float32[Tensor, " N"]:
    """Along one axis, from triangles' middles to their pieces': as a triangle's lies in the middle third of its extent,
    its piece's is taken to be the nearest place in the middle third of what the pixel holds of that extent."""
    low, high = torch.aminmax(position, dim=0)
    low, high = torch.maximum(low.index_select(0, facet), pixel), torch.minimum(high.index_select(0, facet), pixel + 1)
    third, center = (high - low).div_(3), center.index_select(0, facet)
    return center.clamp(low.add_(third), high.sub_(third)).sub_(center).float()


def _nothing(device: torch.device) -> Fragments:
    whole, real = torch.zeros(0, dtype=torch.int64, device=device), torch.zeros(0, dtype=torch.float64, device=device)
    return Fragments(whole, whole, whole, real.float(), Points(whole, whole, real, real), None, None)
