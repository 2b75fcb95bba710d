"""Clipping in view space: triangles that cross the near plane or leave the guard band.

Sutherland-Hodgman in float64, all triangles at once. A crossing point is always computed from the inner end of its edge
towards the outer one, so two triangles that share an edge cut it in the very same point and stay watertight.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int32, Int64
from torch import Tensor

from cloak_core.render.visibility.projection import GRID, GUARD, snap

_CORNERS = 8
"""A triangle cut by five planes has at most this many."""


@dataclass(frozen=True)
class Soup:
    """N snapped triangles, corner by corner."""

    x: Int32[Tensor, "3 N"]
    y: Int32[Tensor, "3 N"]
    corner: Int64[Tensor, "3 N"]
    """Where each corner's nearness stands in `nearness`."""
    nearness: Float64[Tensor, " K"]


def clip(
    corners: Float64[Tensor, "3 xyz=3 N"],
    focal: Float64[Tensor, " N"],
    near: Float64[Tensor, " N"],
    width: int,
    height: int,
) -> tuple[Soup, Int64[Tensor, " M"]]:
    """Cut triangles given in view space to what lies before the near plane and inside the guard band.

    Returns M snapped triangles (none, one or several for each) and the index of the triangle each is a part of.
    """
    count = corners.shape[-1]
    polygon = corners.new_zeros(_CORNERS, 3, count)
    polygon[:3] = corners
    size = torch.full((count,), 3, dtype=torch.int64, device=corners.device)
    guard = GUARD / GRID
    polygon, size = _cut(polygon, size, lambda p: p[:, 2] - near)
    for axis, center in ((0, width / 2), (1, height / 2)):
        for sign in (1.0, -1.0):
            reach = guard - center  # the guard band is centred on the image's corner, the view on its middle
            polygon, size = _cut(polygon, size, lambda p, a=axis, s=sign, r=reach: p[:, a] * focal * s + p[:, 2] * r)
    part = torch.arange(1, _CORNERS - 1, device=corners.device).unsqueeze(-1)
    fan, owner = (part < size - 1).nonzero(as_tuple=True)
    fan = fan + 1
    pieces = torch.stack([polygon[corner, :, owner] for corner in (torch.zeros_like(fan), fan, fan + 1)])
    x, y = snap(pieces.unbind(-1), focal[owner], near[owner], width, height)
    nearness = (near[owner] / pieces[..., 2]).view(-1)
    return Soup(x, y, torch.arange(x.numel(), device=x.device).view(x.shape), nearness), owner


def _cut(polygon: Tensor, size: Tensor, distance: object) -> tuple[Tensor, Tensor]:
    """Keep the part of each convex polygon [C, 3, N] (its first `size` corners count) where distance(corner) >= 0."""
    capacity, _, count = polygon.shape
    slot = torch.arange(capacity, device=polygon.device).unsqueeze(-1)
    d = distance(polygon)
    used = slot < size
    after = torch.where(slot + 1 < size, slot + 1, torch.zeros_like(slot))
    next_corner = polygon.gather(0, after.unsqueeze(1).expand(-1, 3, -1))
    next_d = d.gather(0, after)
    inside, next_inside = d >= 0, next_d >= 0
    crossing = used & (inside != next_inside)
    inner = torch.where(inside.unsqueeze(1), polygon, next_corner)
    outer = torch.where(inside.unsqueeze(1), next_corner, polygon)
    inner_d, outer_d = torch.where(inside, d, next_d), torch.where(inside, next_d, d)
    share = torch.where(crossing, inner_d / (inner_d - outer_d), torch.zeros_like(d)).unsqueeze(1)
    points = torch.stack([polygon, inner + share * (outer - inner)], 1).view(2 * capacity, 3, count)
    emitted = torch.stack([used & inside, crossing], 1).view(2 * capacity, count)
    # Emitted points move up to the front; the rest goes to one slot behind the last, which is cut off.
    place = torch.where(emitted, emitted.cumsum(0) - 1, torch.full_like(slot[:1], capacity))
    result = polygon.new_zeros(capacity + 1, 3, count)
    result.scatter_(0, place.unsqueeze(1).expand(-1, 3, -1), points)
    return result[:capacity], emitted.sum(0)
