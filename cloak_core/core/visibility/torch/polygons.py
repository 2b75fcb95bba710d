"""Many convex polygons at once, in torch: cut and measured.

N polygons of up to C corners are one tensor of their coordinates, [C, D, N]; beyond a polygon's size the last of its
corners stands again and again.
"""

from __future__ import annotations

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

TOUCH = 1e-12
"""Pixels within which a corner counts as lying on a line: rounding stays below 1e-13."""

Line = tuple[Tensor, Tensor, Tensor]
"""a, b and c of each of N lines: a x + b y + c >= 0 on the inner side, in pixels."""


def cut(
    corners: Float64[Tensor, "C D N"], distance: Float64[Tensor, "C N"]
) -> tuple[Float64[Tensor, "K D N"], Int64[Tensor, " N"]]:
    """Keep the part where the distance, linear and given at each corner, is not negative (Sutherland and Hodgman).

    Also returns how many corners each has, 0 where nothing is left. A crossing point is always computed from the inner
    end of its edge towards the outer one, so two polygons that share an edge cut it in the very same point.
    """
    after, following = corners.roll(-1, 0), distance.roll(-1, 0)
    inside, crossing = distance >= 0, distance * following < 0
    start, end = (torch.where(inside.unsqueeze(1), *pair) for pair in ((corners, after), (after, corners)))
    inner, outer = (torch.where(inside, *pair) for pair in ((distance, following), (following, distance)))
    share = torch.where(crossing, inner / torch.where(crossing, inner - outer, 1.0), 0.0).unsqueeze(1)
    points = torch.stack([corners, start + share * (end - start)], 1).flatten(0, 1)
    emitted = torch.stack([inside, crossing], 1).flatten(0, 1)
    count = emitted.sum(0)
    # Emitted points move up to the front; behind them the last stands again.
    order = torch.argsort(~emitted, dim=0, stable=True)
    room = max(3, int(count.max())) if count.numel() else 3
    slot = torch.arange(room, device=count.device).unsqueeze(1)
    source = order.gather(0, torch.minimum(slot, (count - 1).clamp(min=0)))
    return points.gather(0, source.unsqueeze(1).expand(-1, corners.shape[1], -1)), count


def distances(corners: Float64[Tensor, "C 2 N"], line: Line) -> Float64[Tensor, "C N"]:
    """Compute how far inside a line each corner lies; 0 on it."""
    a, b, c = line
    distance = a * corners[:, 0] + b * corners[:, 1] + c
    return distance.masked_fill(distance.abs() <= TOUCH, 0.0)


def inner_part(corners: Float64[Tensor, "C 2 N"], line: Line) -> Float64[Tensor, "K 2 N"]:
    """Keep the part on the inner side of a line; all corners in one point where nothing does."""
    part, count = cut(corners, distances(corners, line))
    return torch.where(count > 0, part, 0.0)


def join(parts: list[Float64[Tensor, "_ 2 _"]]) -> Float64[Tensor, "C 2 N"]:
    """Polygons beside each other."""
    room = max(len(part) for part in parts)
    return torch.cat([torch.cat([part, part[-1:].expand(room - len(part), -1, -1)]) for part in parts], -1)


def measure(corners: Float64[Tensor, "C 2 N"]) -> Float64[Tensor, "3 N"]:
    """Compute the area, and its first moments in x and y: the area times the centroid."""
    first = corners[0]
    here = corners - first  # about the first corner, so that nothing cancels
    cross = here[:-1, 0] * here[1:, 1] - here[:-1, 1] * here[1:, 0]
    area = cross.sum(0) / 2
    moments = ((here[:-1] + here[1:]) * cross.unsqueeze(1)).sum(0) / 6
    return torch.cat([area.unsqueeze(0), moments + area * first])
