"""Many convex polygons at once, in torch: cut by lines, measured. A line is a x + b y + c >= 0 on its inner side."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

TOUCH = 1e-12
"""Pixels within which a corner counts as lying on a line: rounding stays below 1e-13."""

Line = tuple[Tensor, Tensor, Tensor]


@dataclass(frozen=True)
class Polygons:
    """N convex polygons of up to C corners, clockwise on a screen with y down; beyond a polygon's size the last of its
    corners stands again and again."""

    x: Float64[Tensor, "C N"]
    y: Float64[Tensor, "C N"]

    def take(self, index: Int64[Tensor, " M"]) -> Polygons:
        return Polygons(self.x.index_select(1, index), self.y.index_select(1, index))

    @staticmethod
    def join(parts: list[Polygons]) -> Polygons:
        corners = max(len(part.x) for part in parts)

        def padded(t: Tensor) -> Tensor:
            return torch.cat([t, t[-1:].expand(corners - len(t), -1)])

        return Polygons(*(torch.cat([padded(getattr(part, axis)) for part in parts], 1) for axis in "xy"))

    def distance(self, line: Line) -> Float64[Tensor, "C N"]:
        """How far inside the line each corner lies; 0 on it."""
        a, b, c = line
        distance = a * self.x + b * self.y + c
        return distance.masked_fill(distance.abs() <= TOUCH, 0.0)

    def cut(self, line: Line) -> Polygons:
        """What lies on the inner side (Sutherland and Hodgman); all corners in one point where nothing does."""
        here = self.distance(line)
        x, y, following = (torch.roll(t, -1, 0) for t in (self.x, self.y, here))
        crossing = here * following < 0
        share = torch.where(crossing, here / torch.where(crossing, here - following, 1.0), 0.0)
        emitted = torch.stack([here >= 0, crossing], 1).flatten(0, 1)
        # Emitted corners move up to the front; behind them the last stands again.
        order = torch.argsort(~emitted, dim=0, stable=True)
        count = emitted.sum(0)
        room = max(1, int(count.max())) if count.numel() else 1
        slot = torch.arange(room, device=count.device).unsqueeze(1)
        source = order.gather(0, torch.minimum(slot, (count - 1).clamp(min=0)))

        def corners(t: Tensor, after: Tensor) -> Tensor:
            points = torch.stack([t, t + share * (after - t)], 1).flatten(0, 1)
            return torch.where(count > 0, points.gather(0, source), 0.0)

        return Polygons(corners(self.x, x), corners(self.y, y))

    def reaches_inside(self, line: Line) -> Bool[Tensor, " N"]:
        """Whether any corner lies on the inner side and not on the line."""
        return (self.distance(line) > 0).any(0)

    def measure(self) -> tuple[Float64[Tensor, " N"], Float64[Tensor, " N"], Float64[Tensor, " N"]]:
        """Area, and its first moments in x and y: the area times the centroid."""
        x, y = self.x - self.x[0], self.y - self.y[0]  # about the first corner, so that nothing cancels
        cross = x[:-1] * y[1:] - y[:-1] * x[1:]
        area = cross.sum(0) / 2
        across, down = (((t[:-1] + t[1:]) * cross).sum(0) / 6 for t in (x, y))
        return area, across + area * self.x[0], down + area * self.y[0]
