"""Doubtful pixels: which share of each triangle's piece is in front of the others.

Where the nearest pieces add up to the pixel, they hide the others. Elsewhere it is judged at samples of the pixel.

The samples, `SIDE` x `SIDE` to a pixel, are covered by the rasterizer's own exact steps, but only in doubtful pixels
and only where a piece lies: most pieces are so small that they hold few samples or none.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float64, Int32, Int64
from torch import Tensor

from cloak_core.render.area_loops import NOTHING, SIDE, WHOLE
from cloak_core.render.candidates import Candidates, SampleGrid, Soup, Window
from cloak_core.render.covering import Setup, chunk_size
from cloak_core.render.projection import GRID, Screen
from cloak_core.render.rasterizer import EMPTY, inverse_depth, triangle_ids


class _Record:
    """Arrays whose last axis counts the same things."""

    def take(self, index: Int64[Tensor, " K"]) -> object:
        """The same record with these of its entries."""
        rows = lambda t: t.index_select(0, index) if t.ndim == 1 else torch.stack([r.index_select(0, index) for r in t])
        return type(self)(*(rows(getattr(self, field.name)) for field in fields(self)))

    @classmethod
    def join(cls, records: list) -> object:
        if len(records) == 1:
            return records[0]
        return cls(*(torch.cat([getattr(r, field.name) for r in records], -1) for field in fields(cls)))


@dataclass(frozen=True)
class Pieces(_Record):
    """P overlaps of a triangle with a pixel, each with an area above 0."""

    place: Int64[Tensor, " P"]
    """View and pixel, (view * H + y) * W + x."""
    owner: Int64[Tensor, " P"]
    """Index into `Triangles`."""
    area: Float64[Tensor, " P"]
    """Share of the pixel."""


@dataclass(frozen=True)
class Triangles(_Record):
    """M candidate triangles on the snapped screen, corner by corner."""

    view: Int64[Tensor, " M"]
    ids: Int64[Tensor, " M"]
    x: Int32[Tensor, "3 M"]
    y: Int32[Tensor, "3 M"]
    nearness: Float64[Tensor, "3 M"]
    clockwise: Bool[Tensor, " M"]
    large: Bool[Tensor, " M"]
    """Whether edge functions are only exact in int64."""


def seen_share(pieces: Pieces, tri: Triangles, screen: Screen, window: Window) -> Float64[Tensor, " P"]:
    """Which share of each piece is in front: 1 where a pixel's pieces add up to it, else what competition leaves.

    pieces: sorted by place.
    """
    share = torch.ones_like(pieces.area)
    places = len(screen.x) * screen.width * screen.height
    total = torch.zeros(places, dtype=torch.float64, device=share.device).index_add_(0, pieces.place, pieces.area)
    total = total.index_select(0, pieces.place)
    doubtful = ((total - 1).abs() > WHOLE).nonzero().view(-1)
    if not len(doubtful):
        return share
    front, settled = _front_layers(pieces.take(doubtful), tri)
    share[doubtful] = front.to(share.dtype)
    doubtful = doubtful[~settled]
    if not len(doubtful):
        return share
    total, some = total.index_select(0, doubtful), pieces.take(doubtful)
    place, group, size = torch.unique_consecutive(some.place, return_inverse=True, return_counts=True)
    box = SampleGrid(window, SIDE).box(tri.x, tri.y)
    for groups, part in _parts(size):
        own, first = some.take(torch.arange(part.start, part.stop, device=group.device)), groups.start
        arena = _Arena(own, group[part] - first, place[groups], tri, box, screen)
        share[doubtful[part]] = _fit(arena.seen(), own.area, arena.group, arena.filled() & (total[part] >= 1))
    return share


def _front_layers(pieces: Pieces, tri: Triangles) -> tuple[Bool[Tensor, " P"], Bool[Tensor, " P"]]:
    """Where the nearest pieces of a pixel add up to it and lie wholly before all its others: they alone are seen.

    pieces: sorted by place. Returns which pieces are such, and which lie in pixels that are settled so.
    """
    near, far = (t.index_select(0, pieces.owner) for t in (tri.nearness.amax(0), tri.nearness.amin(0)))
    group = torch.unique_consecutive(pieces.place, return_inverse=True)[1]
    order = torch.sort(near, descending=True, stable=True).indices
    order = order[torch.sort(group[order], stable=True).indices]
    own, ends = group[order], pieces.area[order].cumsum(0)
    first = torch.ones_like(own, dtype=torch.bool)
    first[1:] = own[1:] != own[:-1]
    ends = ends - (ends - pieces.area[order])[first][own]
    front = ends - pieces.area[order] < 1 - WHOLE
    groups = int(own[-1]) + 1
    of_group = lambda values, how, empty: torch.full(
        (groups,), empty, dtype=torch.float64, device=values.device
    ).scatter_reduce_(0, own, values, how)
    total = of_group(torch.where(front, ends, -torch.inf), "amax", -torch.inf)
    back = of_group(torch.where(front, far[order], torch.inf), "amin", torch.inf)
    following = of_group(torch.where(front, -torch.inf, near[order]), "amax", -torch.inf)
    settled = ((total - 1).abs() <= WHOLE) & (following < back)
    result = torch.empty_like(front)
    result[order] = front
    return result & settled[group], settled[group]


def _parts(size: Int64[Tensor, " G"]) -> Iterator[tuple[slice, slice]]:
    """Pixels with so many pieces each, in parts whose samples fit: which pixels, and which pieces."""
    ends = [0, *size.cumsum(0).tolist()]
    step = max(1, 16 * chunk_size(size.device) // SIDE**2)
    for start, stop in itertools.pairwise([*range(0, len(size), step), len(size)]):
        yield slice(start, stop), slice(ends[start], ends[stop])


class _Arena:
    """The pieces of G pixels and what is in front at each of their samples."""

    def __init__(
        self, pieces: Pieces, group: Tensor, place: Tensor, tri: Triangles, box: tuple[Tensor, ...], screen: Screen
    ) -> None:
        self.pieces, self.group, self.tri, self.focal = pieces, group, tri, screen.focal.view(-1)
        row = torch.div(place, screen.width, rounding_mode="floor")
        self.column = (place - row * screen.width).index_select(0, group)
        self.row = (row % screen.height).index_select(0, group)
        self.keys = torch.full((len(place) * SIDE * SIDE,), EMPTY, dtype=torch.int64, device=place.device)
        self.held = torch.zeros_like(group)
        """Samples that each piece holds."""
        self._cover(box)

    def _cover(self, box: tuple[Tensor, ...]) -> None:
        left, top = self.column * SIDE, self.row * SIDE
        c0, c1, r0, r1 = (t.index_select(0, self.pieces.owner) for t in box)
        c0, c1 = torch.maximum(c0, left), torch.minimum(c1, left + (SIDE - 1))
        r0, r1 = torch.maximum(r0, top), torch.minimum(r1, top + (SIDE - 1))
        first = (self.group * SIDE + r0 - top) * SIDE + c0 - left
        some = torch.minimum(c1 - c0, r1 - r0) >= 0
        tri = self.tri
        soup = Soup(tri.x, tri.y, torch.arange(tri.x.numel(), device=left.device).view(3, -1), tri.nearness.view(-1))
        large = tri.large.index_select(0, self.pieces.owner)
        for exact, chosen in ((torch.float64, some & ~large), (torch.int64, some & large)):
            for index in chosen.nonzero().view(-1).split(chunk_size(left.device)):
                owner = self.pieces.owner.index_select(0, index)
                own = tuple(t.index_select(0, index).to(torch.int32) for t in (c0, c1, r0, r1))
                found = Candidates(owner, own, tri.clockwise.index_select(0, owner))
                setup = Setup.build(GRID // SIDE, SIDE, soup, found, first.index_select(0, index), index, exact)
                for rows in setup.rows():
                    self.held.index_add_(0, index.index_select(0, rows.owner), rows.count)
                    for sample, key in rows.hits():
                        self.keys.scatter_reduce_(0, sample, key, "amin")

    def seen(self) -> Float64[Tensor, " P"]:
        """Share of each piece that is in front of the other pieces of its pixel."""
        won = torch.bincount(triangle_ids(self.keys).add_(1), minlength=len(self.group) + 1)[1:]
        seen = won.to(torch.float64).div_(self.held.clamp(min=1))
        alone = (self.held == 0).nonzero().view(-1)
        seen.index_copy_(0, alone, self._near_enough(alone).to(torch.float64))
        return seen

    def filled(self) -> Bool[Tensor, " P"]:
        """Of each piece, whether its pixel has something at every sample."""
        return (self.keys.view(-1, SIDE * SIDE) != EMPTY).all(1).index_select(0, self.group)

    def _near_enough(self, index: Int64[Tensor, " K"]) -> Bool[Tensor, " K"]:
        """Whether pieces that hold no sample are seen: judged where they lie, against the sample next to them.

        They are seen unless what is seen there is nearer than their own plane by more than the size of a pixel.
        """
        pick = lambda t: t.index_select(0, index)
        tri, column, row, group = (
            self.tri.take(pick(self.pieces.owner)),
            *map(pick, (self.column, self.row, self.group)),
        )
        x, y = (t.to(torch.float64).div_(GRID) for t in (tri.x, tri.y))
        across, down = (((_middle(t, p) - p) * SIDE).floor_().clamp_(0, SIDE - 1) for t, p in ((x, column), (y, row)))
        own = _nearness(x, y, tri.nearness, (across + 0.5) / SIDE + column, (down + 0.5) / SIDE + row)
        own = torch.minimum(torch.maximum(own, tri.nearness.amin(0)), tri.nearness.amax(0))
        key = self.keys.index_select(0, (down * SIDE + across).to(torch.int64).add_(group * SIDE * SIDE))
        return own >= inverse_depth(key) * (1 - 1 / self.focal.index_select(0, tri.view))


def _nearness(x: Tensor, y: Tensor, nearness: Tensor, at_x: Tensor, at_y: Tensor) -> Float64[Tensor, " K"]:
    """Of triangles' planes at points of the screen."""
    (x0, x1, x2), (y0, y1, y2), (n0, n1, n2) = x, y, nearness
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    w1 = ((y2 - y0) * (at_x - x0) - (x2 - x0) * (at_y - y0)) / area
    w2 = ((x1 - x0) * (at_y - y0) - (y1 - y0) * (at_x - x0)) / area
    return w1 * (n1 - n0) + w2 * (n2 - n0) + n0


def _middle(position: Float64[Tensor, "3 P"], pixel: Int64[Tensor, " P"]) -> Float64[Tensor, " P"]:
    """Middle of the part of the triangle's extent that lies in the pixel."""
    return (torch.maximum(position.amin(0), pixel) + torch.minimum(position.amax(0), pixel + 1)) / 2


def _fit(seen: Tensor, area: Tensor, group: Tensor, full: Bool[Tensor, " P"]) -> Float64[Tensor, " P"]:
    """Shares that fill a pixel at most once, and just once where it is full."""
    sums = torch.zeros(int(group[-1]) + 1, dtype=torch.float64, device=seen.device).index_add_(0, group, area * seen)
    sums = sums.index_select(0, group)
    return seen / torch.where(full, sums.clamp(min=NOTHING), sums.clamp(min=1))
