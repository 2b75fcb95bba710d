"""Fragments by exact area: how much of each pixel each triangle covers.

Most triangles of a body are smaller than a pixel, and samples miss many of them altogether. So every candidate triangle
is clipped against every pixel that it touches, in closed form (float64). In a pixel whose pieces add up to exactly one
pixel nothing overlaps and all of them are seen: their areas are the answer. Only in doubtful pixels, along silhouettes
and folds, the pieces compete at samples of the pixel.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float32, Float64, Int64
from torch import Tensor

from cloak_core.render.candidates import PixelGrid, Window
from cloak_core.render.covering import chunk_size, expand
from cloak_core.render.fragments import Fragments, Points
from cloak_core.render.projection import GRID, Screen
from cloak_core.render.rasterizer import Chunk, candidates

SIDE = 8
"""Samples along the side of a doubtful pixel."""
_WHOLE = 1e-6
"""Areas that add up to 1 within this leave neither gap nor overlap; rounding stays below 1e-9."""
_NOTHING = 1e-9
"""Share of a pixel below which a piece is dropped."""
_SMALL = 4
"""A triangle that touches at most this many pixels is lit once, in its middle."""


@dataclass(frozen=True)
class Pieces:
    """P overlaps of a triangle with a pixel, each with an area above 0."""

    place: Int64[Tensor, " P"]
    """View and pixel, (view * H + y) * W + x."""
    owner: Int64[Tensor, " P"]
    """Index into `Candidates` of the same chunk, over all chunks."""
    column: Int64[Tensor, " P"]
    row: Int64[Tensor, " P"]
    area: Float64[Tensor, " P"]
    """Share of the pixel."""


@dataclass(frozen=True)
class Triangles:
    """M candidate triangles on the screen, in pixels, corners clockwise."""

    view: Int64[Tensor, " M"]
    ids: Int64[Tensor, " M"]
    x: Float64[Tensor, "3 M"]
    y: Float64[Tensor, "3 M"]
    nearness: Float64[Tensor, "3 M"]
    small: Bool[Tensor, " M"]


def area_fragments(
    screen: Screen, triangles: Int64[Tensor, "3 T"], cull: Bool[Tensor, " B"] | None, window: Window
) -> Fragments:
    """Fragments whose area is the exact overlap of triangle and pixel, times the share of it that is seen.

    triangles, cull and window as for `rasterizer.rasterize`.
    """
    found, parts, count = [], [], 0
    for chunk in candidates(screen, triangles, PixelGrid(window), cull):
        corners = _corners(chunk)
        parts += _overlaps(chunk, corners, screen, count)
        found.append(corners)
        count += len(corners.ids)
    if not parts:
        return _nothing(screen.x.device)
    corners, pieces = _join(Triangles, found), _join(Pieces, parts)
    # int32: the only kind of sort that is fast on the CPU.
    places = len(screen.x) * screen.width * screen.height
    key = pieces.place.to(torch.int32) if places < 1 << 31 else pieces.place
    pieces = _take(pieces, torch.sort(key, stable=True).indices)
    area = pieces.area * _seen_share(pieces, corners, screen, places)
    return _light_points(_take(pieces, kept := (area > _NOTHING).nonzero().view(-1)), area[kept], corners, screen)


def _corners(chunk: Chunk) -> Triangles:
    soup, found = chunk.soup, chunk.found
    corner = torch.arange(3, device=found.index.device).unsqueeze(-1)
    # Counter-clockwise triangles swap two corners.
    turned = torch.where(found.clockwise | (corner == 0), corner, 3 - corner) * soup.x.shape[1] + found.index
    flat = lambda t: t.reshape(-1).index_select(0, turned.view(-1)).view(3, -1)
    x, y = (flat(t).to(torch.float64).div_(GRID) for t in (soup.x, soup.y))
    nearness = soup.nearness.index_select(0, flat(soup.corner).view(-1)).view(3, -1)
    c0, c1, r0, r1 = found.box
    view = torch.zeros_like(chunk.ids) if chunk.view is None else chunk.view
    return Triangles(view, chunk.ids, x, y, nearness, (c1 - c0 + 1) * (r1 - r0 + 1) <= _SMALL)


def _overlaps(chunk: Chunk, corners: Triangles, screen: Screen, before: int) -> Iterator[Pieces]:
    """All overlaps of a chunk's triangles with pixels."""
    c0, c1, r0, r1 = (t.to(torch.int64) for t in chunk.found.box)
    across = c1 - c0 + 1
    for owner, offset in expand(across * (r1 - r0 + 1)):
        width = across.index_select(0, owner)
        down = torch.div(offset, width, rounding_mode="floor")
        row, column = r0.index_select(0, owner) + down, c0.index_select(0, owner) + offset - down * width
        x = [t.index_select(0, owner).sub_(column) for t in corners.x]
        y = [t.index_select(0, owner).sub_(row) for t in corners.y]
        area = clipped_area(x, y)
        keep = (area > _NOTHING).nonzero().view(-1)
        owner, row, column = (t.index_select(0, keep) for t in (owner, row, column))
        place = row * screen.width + column
        if chunk.view is not None:
            place += chunk.view.index_select(0, owner) * (screen.width * screen.height)
        yield Pieces(place, owner + before, column, row, area.index_select(0, keep))


def clipped_area(x: list[Tensor], y: list[Tensor]) -> Float64[Tensor, " P"]:
    """Area within the unit square of clockwise triangles, corner by corner (y down).

    By Green's theorem, edge by edge: what lies to the left of an edge inside the square is the height that the edge
    spans there times the mean of its x, clamped to [0, 1].
    """
    inner = [t.clamp(0, 1) for t in y]
    total = None
    for i, j in ((0, 1), (1, 2), (2, 0)):
        dy = y[j] - y[i]
        slope = (x[j] - x[i]).div_(dy.masked_fill_(dy == 0, 1))
        start = (inner[i] - y[i]).mul_(slope).add_(x[i])
        end = (inner[j] - y[i]).mul_(slope).add_(x[i])
        part = _mean_clamped(start, end).mul_(inner[j] - inner[i])
        total = part if total is None else total.add_(part)
    return total


def _mean_clamped(a: Tensor, b: Tensor) -> Tensor:
    """Mean of clamp(t, 0, 1) for t between a and b."""
    low, high = torch.minimum(a, b), torch.maximum(a, b)
    inner_low, inner_high = low.clamp(0, 1), high.clamp(0, 1)
    # The part within (0, 1) contributes its trapezoid, the part beyond 1 its length.
    within = (inner_high - inner_low).mul_(inner_low + inner_high).div_(2)
    length = high - low
    beyond = high.clamp_(min=1).sub_(low.clamp_(min=1))
    mean = within.add_(beyond).div_(length)
    return torch.where(length > 1e-9, mean, (inner_low + inner_high) / 2)


def _seen_share(pieces: Pieces, corners: Triangles, screen: Screen, places: int) -> Float64[Tensor, " P"]:
    """Which share of each piece is in front: 1 where a pixel's pieces add up to it, else what competition leaves."""
    share = torch.ones_like(pieces.area)
    total = torch.zeros(places, dtype=torch.float64, device=share.device).index_add_(0, pieces.place, pieces.area)
    total = total.index_select(0, pieces.place)
    doubtful = ((total - 1).abs() > _WHOLE).nonzero().view(-1)
    if not len(doubtful):
        return share
    some = _take(pieces, doubtful)
    _, group, size = torch.unique_consecutive(some.place, return_inverse=True, return_counts=True)
    ends = size.cumsum(0)
    cuts = torch.searchsorted(
        ends, torch.arange(0, len(doubtful), max(1, 4 * chunk_size(ends.device) // SIDE**2), device=ends.device)
    )
    cuts = sorted({0, *ends.index_select(0, cuts).tolist(), len(doubtful)})
    for start, stop in itertools.pairwise(cuts):
        part = torch.arange(start, stop, device=ends.device)
        first = int(group[start])
        local = group[start:stop] - first
        seen, covered = _compete(_take(some, part), local, int(local[-1]) + 1, corners, screen.focal)
        full = covered.index_select(0, local) & (total[doubtful[start:stop]] >= 1)
        share[doubtful[start:stop]] = _fit(seen, some.area[start:stop], local, full)
    return share


def _compete(
    pieces: Pieces, group: Int64[Tensor, " P"], groups: int, corners: Triangles, focal: Float64[Tensor, "B 1"]
) -> tuple[Float64[Tensor, " P"], Bool[Tensor, " G"]]:
    """Share of each piece that is in front of the other pieces of its pixel (its group), and which pixels have
    something at every sample."""
    tri = _take(corners, pieces.owner)
    inside, nearness = _sampled(tri, pieces.column, pieces.row)
    samples = SIDE * SIDE
    slot = (torch.arange(samples, device=group.device).unsqueeze(1) * groups + group).view(-1)
    best = torch.full((samples * groups,), -1.0, device=group.device)
    best.scatter_reduce_(0, slot, nearness.view(-1), "amax")
    won = inside & (nearness >= best.index_select(0, slot).view(samples, -1))
    held = inside.sum(0)
    seen = won.sum(0).to(torch.float64) / held.clamp(min=1)
    alone = (held == 0).nonzero().view(-1)
    if len(alone):
        pieces, tri, group = _take(pieces, alone), _take(tri, alone), group.index_select(0, alone)
        seen[alone] = _near_enough(tri, pieces.column, pieces.row, best, group, groups, focal).to(torch.float64)
    return seen, best.view(samples, groups).amin(0) >= 0


def _sampled(tri: Triangles, column: Tensor, row: Tensor) -> tuple[Bool[Tensor, "S P"], Float32[Tensor, "S P"]]:
    """Whether triangles hold the samples of a pixel each, and how near they are there (-1 where they do not)."""
    x, y = [t - column for t in tri.x], [t - row for t in tri.y]
    d1x, d2x, d1y, d2y = x[1] - x[0], x[2] - x[0], y[1] - y[0], y[2] - y[0]
    area = (d1x * d2y).sub_(d1y * d2x)
    # The weights of corners 1 and 2 and the nearness are linear on the pixel: value = across * x + down * y + start.
    across, down = [d2y / area, -d1y / area], [-d2x / area, d1x / area]
    start = [-(a * x[0] + d * y[0]) for a, d in zip(across, down, strict=True)]
    n0, g1, g2 = tri.nearness[0], tri.nearness[1] - tri.nearness[0], tri.nearness[2] - tri.nearness[0]
    for parts, constant in ((across, 0), (down, 0), (start, n0)):
        parts.append(constant + parts[0] * g1 + parts[1] * g2)
    offset = ((torch.arange(SIDE, device=area.device) + 0.5) / SIDE).unsqueeze(1)
    on_grid = lambda a, d, s: (offset * a.float() + s.float()) + (offset * d.float()).unsqueeze(1)  # [row, column, P]
    w1, w2, nearness = (on_grid(*line).view(SIDE * SIDE, -1) for line in zip(across, down, start, strict=True))
    inside = torch.minimum(torch.minimum(w1, w2), (1 - w1).sub_(w2)) >= 0
    low, high = tri.nearness.amin(0).float(), tri.nearness.amax(0).float()
    nearness = torch.minimum(torch.maximum(nearness, low), high)  # slivers extrapolate far
    return inside, nearness.masked_fill_(~inside, -1)


def _near_enough(
    tri: Triangles, column: Tensor, row: Tensor, best: Tensor, group: Tensor, groups: int, focal: Tensor
) -> Bool[Tensor, " K"]:
    """Whether pieces that hold no sample are seen: judged where they lie, against the sample next to them.

    They are seen unless what is seen there is nearer than their own plane by more than the size of a pixel.
    """
    place = lambda t, pixel: ((_middle(t, pixel) - pixel) * SIDE).floor_().clamp_(0, SIDE - 1)
    across, down = place(tri.x, column), place(tri.y, row)
    x, y = ((index + 0.5) / SIDE + pixel for index, pixel in ((across, column), (down, row)))
    own = torch.minimum(torch.maximum(_nearness(tri, x, y), tri.nearness.amin(0)), tri.nearness.amax(0))
    there = best.index_select(0, (down * SIDE + across).to(torch.int64) * groups + group)
    return own >= there * (1 - 1 / focal.view(-1).index_select(0, tri.view))


def _nearness(tri: Triangles, x: Tensor, y: Tensor) -> Float64[Tensor, " K"]:
    """Of triangles' planes at points of the screen."""
    (x0, x1, x2), (y0, y1, y2), (n0, n1, n2) = tri.x, tri.y, tri.nearness
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    w1 = ((y2 - y0) * (x - x0) - (x2 - x0) * (y - y0)) / area
    w2 = ((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / area
    return w1 * (n1 - n0) + w2 * (n2 - n0) + n0


def _middle(position: Float64[Tensor, "3 P"], pixel: Int64[Tensor, " P"]) -> Float64[Tensor, " P"]:
    """Middle of the part of the triangle's extent that lies in the pixel."""
    return (torch.maximum(position.amin(0), pixel) + torch.minimum(position.amax(0), pixel + 1)) / 2


def _fit(seen: Tensor, area: Tensor, group: Tensor, full: Bool[Tensor, " P"]) -> Float64[Tensor, " P"]:
    """Shares that fill a pixel at most once, and just once where it is full."""
    sums = torch.zeros(int(group[-1]) + 1, dtype=torch.float64, device=seen.device).index_add_(0, group, area * seen)
    sums = sums.index_select(0, group)
    return seen / torch.where(full, sums.clamp(min=_NOTHING), sums.clamp(min=1))


def _light_points(pieces: Pieces, area: Tensor, corners: Triangles, screen: Screen) -> Fragments:
    """Small triangles are lit once, in the middle; of others, each piece is."""
    own = (~corners.small.index_select(0, pieces.owner)).nonzero().view(-1)
    owner, column, row = (t.index_select(0, own) for t in (pieces.owner, pieces.column, pieces.row))
    middle = lambda t, pixel: _middle(torch.stack([r.index_select(0, owner) for r in t]), pixel)
    points = Points(
        torch.cat([corners.view, corners.view.index_select(0, owner)]),
        torch.cat([corners.ids, corners.ids.index_select(0, owner)]),
        torch.cat([corners.x.mean(0), middle(corners.x, column)]),
        torch.cat([corners.y.mean(0), middle(corners.y, row)]),
    )
    point = pieces.owner.clone()
    point[own] = len(corners.ids) + torch.arange(len(own), device=own.device)
    view = corners.view.index_select(0, pieces.owner)
    ids = corners.ids.index_select(0, pieces.owner)
    return Fragments(view, pieces.row * screen.width + pieces.column, ids, area.float(), points, point)


def _nothing(device: torch.device) -> Fragments:
    whole, real = torch.zeros(0, dtype=torch.int64, device=device), torch.zeros(0, dtype=torch.float64, device=device)
    return Fragments(whole, whole, whole, real.float(), Points(whole, whole, real, real), None)


def _take(record: object, index: Tensor) -> object:
    """The same record with these of its entries."""
    rows = lambda t: t.index_select(0, index) if t.ndim == 1 else torch.stack([r.index_select(0, index) for r in t])
    return type(record)(*(rows(getattr(record, name)) for name in record.__dataclass_fields__))


def _join(kind: type, records: list) -> object:
    if len(records) == 1:
        return records[0]
    return kind(*(torch.cat([getattr(r, name) for r in records], -1) for name in kind.__dataclass_fields__))
