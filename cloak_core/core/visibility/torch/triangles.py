"""Triangles with area in a canonical order of corners, and pairs of them with pixels or samples, in torch."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from cloak_core.core.view import FlatTriangles

CHUNK = 1 << 16
"""Pairs worked on at once on the CPU; devices with slow starts and much memory take `_DEVICE_CHUNKS` times as many."""
_DEVICE_CHUNKS = 1 << 6


@dataclass(frozen=True)
class Triangles:
    """N triangles with area: corner 0 is the topmost one (of two the right one), the others follow clockwise.

    Edge functions 1 and 2 are integers, A (twice the area) at their corner, 0 along the opposite edge.
    """

    x: Int64[Tensor, "3 N"]
    y: Int64[Tensor, "3 N"]
    inverse_depth: Float64[Tensor, "3 N"]
    ids: Int64[Tensor, " N"]

    def take(self, index: Int64[Tensor, " M"]) -> Triangles:
        return Triangles(*(t.index_select(-1, index) for t in (self.x, self.y, self.inverse_depth, self.ids)))

    def edges(self, own: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Evaluate edge functions 1 and 2 of the triangles `own` at places on the screen, and A."""
        (x0, x1, x2), (y0, y1, y2) = self.x.index_select(1, own), self.y.index_select(1, own)
        right, below, d1x, d1y, d2x, d2y = x - x0, y - y0, x1 - x0, y1 - y0, x2 - x0, y2 - y0
        return d2y * right - d2x * below, d1x * below - d1y * right, d1x * d2y - d1y * d2x

    def inverse_depth_at(self, own: Tensor, x: Tensor, y: Tensor) -> Float64[Tensor, " M"]:
        """(e1 * ((n1 - n0) / A) + e2 * ((n2 - n0) / A)) + n0, one rounding for each operation."""
        (e1, e2, area), (n0, n1, n2) = self.edges(own, x, y), self.inverse_depth.index_select(1, own)
        return (e1.to(torch.float64) * ((n1 - n0) / area) + e2.to(torch.float64) * ((n2 - n0) / area)) + n0


def canonical(flat: FlatTriangles) -> Triangles:
    """Order the corners of the triangles that are not dropped."""
    x, y, inverse_depth = (t[flat.corner] for t in (flat.x.to(torch.int64), flat.y.to(torch.int64), flat.inverse_depth))
    twice = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    keep = ((twice != 0) & ~(flat.one_sided & (twice > 0))).nonzero().view(-1)
    first = torch.argmin((y << 32) - x, 0)
    step = torch.arange(3, device=x.device).unsqueeze(1)
    order = ((first + torch.where(twice > 0, step, -step)) % 3).index_select(1, keep)
    x, y, inverse_depth = (t.index_select(1, keep).gather(0, order) for t in (x, y, inverse_depth))
    return Triangles(x, y, inverse_depth, flat.ids.index_select(0, keep))


def chunk_size(device: torch.device) -> int:
    """Pairs that are worked on at once."""
    return CHUNK if device.type == "cpu" else CHUNK * _DEVICE_CHUNKS


def expand(counts: Int64[Tensor, " N"]) -> Iterator[tuple[Int64[Tensor, " M"], Int64[Tensor, " M"]]]:
    """Repeat each index i counts[i] times, with its offset 0 .. counts[i] - 1, in chunks of about `chunk_size`."""
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
