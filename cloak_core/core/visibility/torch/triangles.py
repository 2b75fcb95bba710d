"""Triangles with area in a canonical order of corners, and pairs of them with pixels or samples, in torch."""

from __future__ import annotations

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

    corners: Int64[Tensor, "xy=2 3 N"]
    inverse_depth: Float64[Tensor, "3 N"]
    ids: Int64[Tensor, " N"]

    def take(self, index: Int64[Tensor, " M"]) -> Triangles:
        return Triangles(*(t.index_select(-1, index) for t in (self.corners, self.inverse_depth, self.ids)))

    def edges(self, own: Tensor, place: Int64[Tensor, "xy=2 M"]) -> tuple[Int64[Tensor, "2 M"], Int64[Tensor, " M"]]:
        """Evaluate edge functions 1 and 2 of the triangles `own` at places on the screen, and A."""
        corners = self.corners.index_select(2, own)
        right, below = place - corners[:, 0]
        (d1x, d2x), (d1y, d2y) = corners[:, 1:] - corners[:, :1]
        return torch.stack([d2y * right - d2x * below, d1x * below - d1y * right]), d1x * d2y - d1y * d2x

    def inverse_depth_at(self, own: Tensor, edges: Int64[Tensor, "2 M"], area: Tensor) -> Float64[Tensor, " M"]:
        """(e1 * ((n1 - n0) / A) + e2 * ((n2 - n0) / A)) + n0, one rounding for each operation."""
        depth = self.inverse_depth.index_select(1, own)
        return (edges.to(torch.float64) * ((depth[1:] - depth[0]) / area)).sum(0) + depth[0]


def canonical(flat: FlatTriangles) -> Triangles:
    """Order the corners of the triangles that are not dropped."""
    corners = torch.stack([flat.x, flat.y]).to(torch.int64)[:, flat.corner]
    (d1x, d2x), (d1y, d2y) = corners[:, 1:] - corners[:, :1]
    twice = d1x * d2y - d2x * d1y
    keep = (torch.where(flat.one_sided, twice.clamp(max=0), twice) != 0).nonzero().view(-1)
    first = torch.argmin((corners[1] << 32) - corners[0], 0)
    step = torch.arange(3, device=first.device).unsqueeze(1)
    order = ((first + twice.sign() * step) % 3).index_select(1, keep)
    return Triangles(
        corners.index_select(2, keep).gather(1, order.expand(2, -1, -1)),
        flat.inverse_depth[flat.corner].index_select(1, keep).gather(0, order),
        flat.ids.index_select(0, keep),
    )


def chunk_size(device: torch.device) -> int:
    """Pairs that are worked on at once."""
    return CHUNK if device.type == "cpu" else CHUNK * _DEVICE_CHUNKS


def expand(counts: Int64[Tensor, " N"]) -> Iterator[tuple[Int64[Tensor, " M"], Int64[Tensor, " M"]]]:
    """Repeat each index i counts[i] times, with its offset 0 .. counts[i] - 1, in chunks of `chunk_size`."""
    if not len(counts):
        return
    ends = counts.cumsum(0)
    begin = ends - counts
    size, total = chunk_size(counts.device), int(ends[-1])
    for first in range(0, total, size):
        number = torch.arange(first, min(first + size, total), device=counts.device)
        owner = torch.searchsorted(ends, number, right=True)
        yield owner, number - begin.index_select(0, owner)


def expand_boxes(
    low: Int64[Tensor, "xy=2 N"], size: Int64[Tensor, "xy=2 N"]
) -> Iterator[tuple[Int64[Tensor, " M"], Int64[Tensor, "xy=2 M"]]]:
    """List the columns and rows of boxes, each with its box's index, in chunks of `chunk_size`."""
    for owner, offset in expand(size.prod(0)):
        across = size[0].index_select(0, owner)
        step = torch.stack([offset % across, torch.div(offset, across, rounding_mode="floor")])
        yield owner, low.index_select(1, owner) + step
