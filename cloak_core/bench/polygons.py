"""Many small convex polygons at once, in float64: cut by half planes, measured."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int64
from torch import Tensor


@dataclass(frozen=True)
class Polygons:
    """N convex polygons of up to C corners, in order; what lies beyond a polygon's size means nothing."""

    x: Float64[Tensor, "C N"]
    y: Float64[Tensor, "C N"]
    size: Int64[Tensor, " N"]

    def take(self, index: Int64[Tensor, " M"]) -> Polygons:
        """These ones."""
        return Polygons(self.x[:, index], self.y[:, index], self.size[index])

    @staticmethod
    def join(parts: list[Polygons]) -> Polygons:
        """All of them, one after the other."""
        corners = max(len(part.x) for part in parts)
        x, y = (
            torch.cat([torch.nn.functional.pad(getattr(p, axis), (0, 0, 0, corners - len(p.x))) for p in parts], 1)
            for axis in "xy"
        )
        return Polygons(x, y, torch.cat([part.size for part in parts]))

    def used(self) -> Tensor:
        """Which corners count, bool [C, N]."""
        return torch.arange(len(self.x)).unsqueeze(1) < self.size

    def measure(self) -> tuple[Float64[Tensor, " N"], Float64[Tensor, " N"], Float64[Tensor, " N"]]:
        """Area, and its first moments in x and y: the area times the centroid."""
        # About the first corner, so that nothing cancels; corners beyond the size stand in for it.
        used = self.used()
        x, y = (torch.where(used, t - t[:1], 0.0) for t in (self.x, self.y))
        cross = x[:-1] * y[1:] - x[1:] * y[:-1]
        area = cross.sum(0) / 2
        sign = torch.where(area < 0, -1.0, 1.0)
        across, down = (
            (((t[:-1] + t[1:]) * cross).sum(0) / 6 + area * origin) * sign
            for t, origin in ((x, self.x[0]), (y, self.y[0]))
        )
        return area * sign, across, down

    def quadrature(self) -> tuple[Int64[Tensor, " Q"], Float64[Tensor, " Q"], Float64[Tensor, " Q"], Tensor]:
        """Points that integrate quadratic functions exactly: polygon, x, y, and the weight, an area.

        Each polygon falls into a fan of triangles, each triangle has three inner points of equal weight.
        """
        fan, owner = (torch.arange(1, max(2, len(self.x) - 1)).unsqueeze(1) < self.size - 1).nonzero(as_tuple=True)
        fan = fan + 1
        x, y = (torch.stack([t[0, owner], t[fan, owner], t[fan + 1, owner]]) for t in (self.x, self.y))
        area = ((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])).abs() / 2
        inner_x, inner_y = ((t / 2 + t.sum(0) / 6).view(-1) for t in (x, y))
        return owner.repeat(3), inner_x, inner_y, (area / 3).repeat(3)


def cut(polygons: Polygons, distance: Float64[Tensor, "C N"]) -> Polygons:
    """What lies where the distance, linear and given at the corners, is not negative (Sutherland and Hodgman)."""
    capacity, count = polygons.x.shape
    slot = torch.arange(capacity).unsqueeze(1)
    used = slot < polygons.size
    after = torch.where(slot + 1 < polygons.size, slot + 1, 0)
    following = distance.gather(0, after)
    inside = distance >= 0
    crossing = used & (inside != (following >= 0))
    share = torch.where(crossing, distance / (distance - following), 0.0)
    emitted = torch.stack([used & inside, crossing], 1).view(2 * capacity, count)
    # Emitted corners move up to the front; the rest goes to one slot behind the last, which is cut off.
    size = emitted.sum(0)
    room = max(1, int(size.max()) if count else 0)
    place = torch.where(emitted, emitted.cumsum(0) - 1, room)

    def corners(t: Tensor) -> Tensor:
        points = torch.stack([t, t + share * (t.gather(0, after) - t)], 1).view(2 * capacity, count)
        return t.new_zeros(room + 1, count).scatter_(0, place, points)[:room]

    return Polygons(corners(polygons.x), corners(polygons.y), size)
