"""Which samples each triangle covers, and how near it is there: the exact inner part of the rasterizer.

Candidates are cut into the rows of samples that their boxes hold, each row into the run of samples between its left and
right edge, and runs into samples.
Edge functions are integers; they are evaluated in float64 where all values stay below 2^53, in int64 for larger
triangles, and never round.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Int64
from torch import Tensor

from cloak_core.render.candidates import Candidates, Soup

ID_BITS = 24
DEPTH_BITS = 39
CHUNK = 1 << 16
"""Triangles, rows or samples worked on at once on the CPU: enough to amortise an operation, few enough to stay in the
cache. Devices with slow starts and much memory take `_DEVICE_CHUNKS` times as many."""
_DEVICE_CHUNKS = 1 << 8
_FAR = 1 << 40
_TINY = 1e-300


@dataclass(frozen=True)
class Setup:
    """M triangles ready for covering, in canonical order.

    Corner 0 is the topmost one (of two the right one), and the corners run clockwise on the screen. So edge 0-2 is on
    the left (or level on top), edge 0-1 on the right and never level; only edge 1-2 may be either. Edge function i is A
    (twice the area) at corner i, 0 along the opposite edge, positive inside; the three add up to A everywhere.
    """

    columns: int
    """From a sample to the one below it, in flat indices."""
    area: Tensor
    """A; like `edge`, `across`, `down` and `width` of the type that holds edge functions exactly."""
    edge: tuple[Tensor, Tensor]
    """Edge functions 1 and 2 at the first sample of the triangle's box."""
    across: tuple[Tensor, Tensor, Tensor]
    """Change of each edge function from one sample to the next in a row (never 0 in float64, see `_level`)."""
    down: tuple[Tensor, Tensor]
    """Change of edge functions 1 and 2 from one row to the next."""
    slope: tuple[Tensor, Tensor]
    """(n1 - n0) / A and (n2 - n0) / A, float64, for nearness n."""
    nearness: Tensor
    """n0, float64."""
    width: Tensor
    """Samples in a row of the box."""
    height: Tensor
    """Rows of the box, int64."""
    first: Tensor
    """Flat index of the box's first sample."""
    ids: Tensor

    @staticmethod
    def build(
        step: int,
        columns: int,
        soup: Soup,
        found: Candidates,
        first: Int64[Tensor, " M"],
        ids: Int64[Tensor, " M"],
        exact: torch.dtype,
    ) -> Setup:
        """step: between samples, in grid units; the other arguments as the attributes of these names."""
        place = _canonical(soup, found)
        flat = lambda t: t.reshape(-1).index_select(0, place.view(-1)).view(3, -1)
        x, y = flat(soup.x).unbind(0), flat(soup.y).unbind(0)
        n0, n1, n2 = soup.nearness.index_select(0, flat(soup.corner).view(-1)).view(3, -1).unbind(0)
        c0, c1, r0, r1 = found.box
        right = (c0 * step).add_(step // 2).sub_(x[0]).to(exact)
        below = (r0 * step).add_(step // 2).sub_(y[0]).to(exact)
        d1x, d2x, d1y, d2y = ((c[i] - c[0]).to(exact) for c in (x, y) for i in (1, 2))
        area = (d1x * d2y).sub_(d1y * d2x)
        edge = (d2y * right).sub_(d2x * below), (d1x * below).sub_(d1y * right)
        size = area.to(torch.float64)
        return Setup(
            columns,
            area,
            edge,
            across=_level(((d1y - d2y).mul_(step), d2y * step, d1y * -step)),
            down=(d2x * -step, d1x * step),
            slope=((n1 - n0).div_(size), (n2 - n0).div_(size)),
            nearness=n0,
            width=(c1 - c0).add_(1).to(exact),
            height=(r1 - r0).add_(1).to(torch.int64),
            first=first,
            ids=ids,
        )

    def rows(self) -> Iterator[Rows]:
        """Every row of samples of every box, with the run of samples that lies inside the triangle."""
        for owner, offset in expand(self.height):
            pick = lambda t, o=owner: t.index_select(0, o)
            below = offset.to(self.width.dtype)
            e1, e2 = (pick(e).add_(pick(d).mul_(below)) for e, d in zip(self.edge, self.down, strict=True))
            e0 = pick(self.area).sub_(e1).sub_(e2)
            low, high = _run((e0, e1, e2), tuple(pick(a) for a in self.across), pick(self.width))
            first = pick(self.first).add_(offset.mul_(self.columns))
            yield Rows(self, owner, (e1, e2), low, (high - low).clamp_(min=0).to(torch.int64), first)


def _canonical(soup: Soup, found: Candidates) -> Int64[Tensor, "3 M"]:
    """Where the soup holds the candidates' corners, put into the order that `Setup` documents."""
    count = soup.x.shape[1]
    corner = torch.arange(3, device=found.index.device).unsqueeze(-1) * count + found.index
    flat = lambda t: t.view(-1).index_select(0, corner.view(-1)).view(3, -1)
    order = (flat(soup.y).to(torch.int64) << 32).sub_(flat(soup.x))
    o0, o1, o2 = order.unbind(0)
    code = (o1 < o0).to(torch.int64)  # which corner is the topmost one ...
    code.masked_fill_(o2 < torch.minimum(o0, o1), 2)
    code.add_(found.clockwise, alpha=3)  # ... and which way round the others follow
    table = torch.tensor([[0, 1, 2, 0, 1, 2], [2, 0, 1, 1, 2, 0], [1, 2, 0, 2, 0, 1]], device=code.device) * count
    return torch.stack([row.index_select(0, code).add_(found.index) for row in table])


def _level(across: tuple[Tensor, Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Steps along a row, with the top-left rule for level edges folded in.

    Along a level edge the edge function does not change. On top (edge 0-2, step 1) it owns its samples like a left
    edge, at the bottom (edge 1-2, step 0) it does not, like a right edge: a step of that sign, too small to change any
    sum, says so. Integers have no such step; `_run` sees to them.
    """
    if across[0].dtype != torch.float64:
        return across
    return across[0].sub_(_TINY), across[1].add_(_TINY), across[2]


def _run(edge: tuple[Tensor, ...], across: tuple[Tensor, ...], width: Tensor) -> tuple[Tensor, Tensor]:
    """The run [low, high) of a row's columns k where every edge + k * across is inside, the top-left rule included.

    A left edge (across > 0) owns its samples: k >= -edge / across. A right edge (across < 0) does not:
    k < -edge / across. Both bounds are the quotient rounded up, and that is exact: float64 rounds a quotient of
    integers whose sizes add up to less than 2^53 to a whole number only where it is one.
    """
    if edge[0].dtype == torch.float64:
        b0, b1, b2 = ((e / a).floor_().neg_() for e, a in zip(edge, across, strict=True))
        left = across[0] * torch.inf  # +-inf: takes edge 1-2 out of the bound that it does not belong to
    else:
        b0, b1, b2 = (
            -torch.div(e, torch.where(a == 0, 1, a), rounding_mode="floor") for e, a in zip(edge, across, strict=True)
        )
        b0 = torch.where(across[0] == 0, torch.where(edge[0] > 0, _FAR, -_FAR), b0)
        b1 = torch.where(across[1] == 0, -_FAR, b1)  # no row of the box lies above the top edge
        left = torch.where(across[0] > 0, _FAR, -_FAR)
    low = torch.maximum(b1, torch.minimum(b0, left)).clamp_(min=0)
    return low, torch.minimum(torch.minimum(width, b2), torch.maximum(b0, left))


@dataclass(frozen=True)
class Rows:
    """R rows of samples, each with its covered run: columns low to low + count of its triangle's box."""

    setup: Setup
    owner: Int64[Tensor, " R"]
    edge: tuple[Tensor, Tensor]
    """Edge functions 1 and 2 at the box's first column."""
    low: Tensor
    count: Int64[Tensor, " R"]
    first: Int64[Tensor, " R"]
    """Flat index of the row's first sample."""

    def hits(self) -> Iterator[tuple[Int64[Tensor, " M"], Int64[Tensor, " M"]]]:
        """Flat index and key of every covered sample: the depth, `DEPTH_BITS` bits, above the triangle's id."""
        setup = self.setup
        limit = (1 << DEPTH_BITS) - 1
        for row, offset in expand(self.count):
            pick = lambda t, r=row: t.index_select(0, r)
            column, owner = pick(self.low).add_(offset), pick(self.owner)
            own = lambda t, o=owner: t.index_select(0, o)
            e1, e2 = (
                own(a).mul_(column).add_(pick(e)).to(torch.float64)
                for a, e in zip(setup.across[1:], self.edge, strict=True)
            )
            nearness = e1.mul_(own(setup.slope[0])).add_(e2.mul_(own(setup.slope[1]))).add_(own(setup.nearness))
            depth = nearness.mul_(1 << DEPTH_BITS).to(torch.int64).clamp_(0, limit)
            key = depth.neg_().add_(limit).bitwise_left_shift_(ID_BITS).bitwise_or_(own(setup.ids))
            yield pick(self.first).add_(column.to(torch.int64)), key


def chunk_size(device: torch.device) -> int:
    """How many elements to work on at once."""
    return CHUNK if device.type == "cpu" else CHUNK * _DEVICE_CHUNKS


def expand(counts: Int64[Tensor, " N"]) -> Iterator[tuple[Int64[Tensor, " M"], Int64[Tensor, " M"]]]:
    """Each index i counts[i] times, with its offset 0 .. counts[i] - 1, in pieces of about `chunk_size`."""
    if not len(counts):
        return
    ends = counts.cumsum(0)
    total = int(ends[-1])
    cuts = [0, len(counts)]
    size = chunk_size(ends.device)
    if total > size:
        inner = torch.searchsorted(ends, torch.arange(size, total, size, device=ends.device))
        cuts = sorted({0, *inner.tolist(), len(counts)})
    for start, stop in itertools.pairwise(cuts):
        before = int(ends[start - 1]) if start else 0
        length = (int(ends[stop - 1]) if stop < len(counts) else total) - before
        if length:
            part = counts[start:stop]
            owner = torch.repeat_interleave(part, output_size=length)
            begin = (ends[start:stop] - part).sub_(before)
            offset = torch.arange(length, device=owner.device).sub_(begin.index_select(0, owner))
            yield (owner.add_(start) if start else owner), offset
