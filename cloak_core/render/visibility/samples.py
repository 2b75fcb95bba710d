"""Which triangle is the nearest at each sample, in torch: every triangle is asked at every sample in its box."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from cloak_core.render.visibility.flat import FlatTriangles
from cloak_core.render.visibility.keys import DEPTH_BITS, ID_BITS, LIMIT


def cover(
    keys: Int64[Tensor, "rows columns"], flat: FlatTriangles, cull: bool, row0: int, column0: int, shift: int
) -> None:
    """Lower `keys` to those of all triangles of a view, at the samples from row0 and column0 on.

    cull: whether clockwise triangles are dropped; shift: there are 2^shift grid units between samples.
    """
    rows, columns = keys.shape
    x, y, nearness, ids = canonical(flat, cull)
    c0, c1 = _span(x, shift, column0, columns)
    r0, r1 = _span(y, shift, row0, rows)
    some = (torch.minimum(c1 - c0, r1 - r0) >= 0).nonzero().view(-1)
    x, y, nearness = (t.index_select(1, some) for t in (x, y, nearness))
    ids, c0, c1, r0, r1 = (t.index_select(0, some) for t in (ids, c0, c1, r0, r1))
    edges = Edges(x, y, nearness)
    for owner, down in expand(r1 - r0 + 1):
        for row, across in expand((c1 - c0 + 1).index_select(0, owner)):
            own = owner.index_select(0, row)
            line, column = (r0.index_select(0, own) + down.index_select(0, row)), c0.index_select(0, own) + across
            at = (t * (1 << shift) + (1 << shift) // 2 for t in (column, line))
            key, inside = _keys(edges, ids, own, *at)
            place = ((line - row0) * columns + column - column0)[inside]
            keys.view(-1).scatter_reduce_(0, place, key[inside], "amin")


def canonical(flat: FlatTriangles, cull: bool) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Triangles with area that are not dropped: x, y (int64) and nearness corner by corner [3, M], and their ids.

    Corner 0 is the topmost one (of two the right one), the others follow clockwise on the screen.
    """
    x, y, nearness = (t[flat.corner] for t in (flat.x.to(torch.int64), flat.y.to(torch.int64), flat.nearness))
    twice = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    keep = (twice < 0 if cull else twice != 0).nonzero().view(-1)
    first = torch.argmin((y << 32) - x, 0)
    step = torch.arange(3, device=x.device).unsqueeze(1)
    order = ((first + torch.where(twice > 0, step, -step)) % 3).index_select(1, keep)
    x, y, nearness = (t.index_select(1, keep).gather(0, order) for t in (x, y, nearness))
    return x, y, nearness, flat.ids.index_select(0, keep)


def _span(position: Int64[Tensor, "3 N"], shift: int, first: int, count: int) -> tuple[Tensor, Tensor]:
    """First and last sample within triangles' extents along one axis."""
    half = (1 << shift) // 2
    low, high = (position.amin(0) + half - 1) >> shift, (position.amax(0) - half) >> shift
    return low.clamp(min=first), high.clamp(max=first + count - 1)


class Edges:
    """Edge functions 1 and 2 of triangles in canonical order: integers, A at their corner, 0 along the edge across."""

    def __init__(self, x: Int64[Tensor, "3 N"], y: Int64[Tensor, "3 N"], nearness: Float64[Tensor, "3 N"]) -> None:
        self.x, self.y = x[0], y[0]
        self.d1x, self.d1y, self.d2x, self.d2y = x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0]
        self.area = self.d1x * self.d2y - self.d1y * self.d2x
        self.n0, self.slopes = nearness[0], (nearness[1:] - nearness[0]) / self.area

    def at(self, own: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Of the triangles `own` at places on the screen."""
        right, below = x - self.x.index_select(0, own), y - self.y.index_select(0, own)
        d1x, d1y, d2x, d2y = (t.index_select(0, own) for t in (self.d1x, self.d1y, self.d2x, self.d2y))
        return d2y * right - d2x * below, d1x * below - d1y * right

    def nearness(self, own: Tensor, x: Tensor, y: Tensor) -> Float64[Tensor, " M"]:
        """(e1 * ((n1 - n0) / A) + e2 * ((n2 - n0) / A)) + n0, one rounding for each operation."""
        (e1, e2), (s1, s2) = self.at(own, x, y), (t.index_select(0, own) for t in self.slopes)
        return (e1.to(torch.float64) * s1 + e2.to(torch.float64) * s2) + self.n0.index_select(0, own)


def _keys(edges: Edges, ids: Tensor, own: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Key of each triangle at a sample, and whether it covers it, by the top-left rule: edge 0-2 is on the left (or
    level on top) and owns its samples, edge 0-1 on the right; edge 1-2 owns them where it is on the left."""
    e1, e2 = edges.at(own, x, y)
    e0 = edges.area.index_select(0, own) - e1 - e2
    left = (edges.d1y > edges.d2y).index_select(0, own)
    inside = (e1 >= 0) & (e2 > 0) & ((e0 > 0) | ((e0 == 0) & left))
    depth = (edges.nearness(own, x, y) * (1 << DEPTH_BITS)).to(torch.int64).clamp(0, LIMIT)
    return ((LIMIT - depth) << ID_BITS) | ids.index_select(0, own), inside


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
