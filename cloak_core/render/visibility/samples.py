"""Which triangle is the nearest at each sample, in torch: every triangle is asked at every sample in its box."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from cloak_core.render.visibility.flat import FlatTriangles
from cloak_core.render.visibility.keys import DEPTH_BITS, ID_BITS, LIMIT


def cover(keys: Int64[Tensor, "rows columns"], flat: FlatTriangles, row0: int, column0: int, shift: int) -> None:
    """Lower `keys` to those of all triangles of a view, at the samples from row0 and column0 on.

    shift: there are 2^shift grid units between samples.
    """
    rows, columns = keys.shape
    triangles = canonical(flat)
    c0, c1 = _span(triangles.x, shift, column0, columns)
    r0, r1 = _span(triangles.y, shift, row0, rows)
    some = (torch.minimum(c1 - c0, r1 - r0) >= 0).nonzero().view(-1)
    triangles, (c0, c1, r0, r1) = triangles.take(some), (t.index_select(0, some) for t in (c0, c1, r0, r1))
    for owner, down in expand(r1 - r0 + 1):
        for row, across in expand((c1 - c0 + 1).index_select(0, owner)):
            own = owner.index_select(0, row)
            line, column = (r0.index_select(0, own) + down.index_select(0, row)), c0.index_select(0, own) + across
            at = (t * (1 << shift) + (1 << shift) // 2 for t in (column, line))
            key, inside = _keys(triangles, own, *at)
            place = ((line - row0) * columns + column - column0)[inside]
            keys.view(-1).scatter_reduce_(0, place, key[inside], "amin")


@dataclass(frozen=True)
class Triangles:
    """N triangles with area: corner 0 is the topmost one (of two the right one), the others follow clockwise on the
    screen. Edge functions 1 and 2 are integers, A at their corner, 0 along the edge across."""

    x: Int64[Tensor, "3 N"]
    y: Int64[Tensor, "3 N"]
    nearness: Float64[Tensor, "3 N"]
    ids: Int64[Tensor, " N"]

    def take(self, index: Int64[Tensor, " M"]) -> Triangles:
        return Triangles(*(t.index_select(-1, index) for t in (self.x, self.y, self.nearness, self.ids)))

    def edges(self, own: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Of the triangles `own` at places on the screen: edge functions 1 and 2, and A."""
        (x0, x1, x2), (y0, y1, y2) = self.x.index_select(1, own), self.y.index_select(1, own)
        right, below, d1x, d1y, d2x, d2y = x - x0, y - y0, x1 - x0, y1 - y0, x2 - x0, y2 - y0
        return d2y * right - d2x * below, d1x * below - d1y * right, d1x * d2y - d1y * d2x

    def nearness_at(self, own: Tensor, x: Tensor, y: Tensor) -> Float64[Tensor, " M"]:
        """(e1 * ((n1 - n0) / A) + e2 * ((n2 - n0) / A)) + n0, one rounding for each operation."""
        (e1, e2, area), (n0, n1, n2) = self.edges(own, x, y), self.nearness.index_select(1, own)
        return (e1.to(torch.float64) * ((n1 - n0) / area) + e2.to(torch.float64) * ((n2 - n0) / area)) + n0


def canonical(flat: FlatTriangles) -> Triangles:
    """Those that are not dropped."""
    x, y, nearness = (t[flat.corner] for t in (flat.x.to(torch.int64), flat.y.to(torch.int64), flat.nearness))
    twice = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    keep = ((twice != 0) & ~(flat.one_sided & (twice > 0))).nonzero().view(-1)
    first = torch.argmin((y << 32) - x, 0)
    step = torch.arange(3, device=x.device).unsqueeze(1)
    order = ((first + torch.where(twice > 0, step, -step)) % 3).index_select(1, keep)
    x, y, nearness = (t.index_select(1, keep).gather(0, order) for t in (x, y, nearness))
    return Triangles(x, y, nearness, flat.ids.index_select(0, keep))


def _span(position: Int64[Tensor, "3 N"], shift: int, first: int, count: int) -> tuple[Tensor, Tensor]:
    """First and last sample within triangles' extents along one axis."""
    half = (1 << shift) // 2
    low, high = (position.amin(0) + half - 1) >> shift, (position.amax(0) - half) >> shift
    return low.clamp(min=first), high.clamp(max=first + count - 1)


def _keys(triangles: Triangles, own: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Key of each triangle at a sample, and whether it covers it, by the top-left rule: edge 0-2 is on the left (or
    level on top) and owns its samples, edge 0-1 on the right; edge 1-2 owns them where it is on the left."""
    e1, e2, area = triangles.edges(own, x, y)
    e0, left = area - e1 - e2, (triangles.y[1] > triangles.y[2]).index_select(0, own)
    inside = (e1 >= 0) & (e2 > 0) & ((e0 > 0) | ((e0 == 0) & left))
    depth = (triangles.nearness_at(own, x, y) * (1 << DEPTH_BITS)).to(torch.int64).clamp(0, LIMIT)
    return ((LIMIT - depth) << ID_BITS) | triangles.ids.index_select(0, own), inside


CHUNK = 1 << 16
"""Pairs worked on at once on the CPU; devices with slow starts and much memory take `_DEVICE_CHUNKS` times as many."""
_DEVICE_CHUNKS = 1 << 6


def chunk_size(device: torch.device) -> int:
    return CHUNK if device.type == "cpu" else CHUNK * _DEVICE_CHUNKS


def expand(counts: Int64[Tensor, " N"]) -> Iterator[tuple[Int64[Tensor, " M"], Int64[Tensor, " M"]]]:
    """Each index i counts[i] times, with its offset 0 .. counts[i] - 1, in pieces of about `chunk_size`."""
    if not len(counts):
        return
    ends = counts.cumsum(0)
    size = chunk_size(counts.device)
    marks = torch.arange(size, max(int(ends[-1]), size), size, device=ends.device)
    cuts = sorted({0, *torch.searchsorted(ends, marks).tolist(), len(counts)})
    for start, stop in itertools.pairwise(cuts):
        part = counts[start:stop]
        owner = torch.repeat_interleave(part)
        offset = torch.arange(len(owner), device=owner.device) - (part.cumsum(0) - part).index_select(0, owner)
        if len(owner):
            yield owner + start, offset
