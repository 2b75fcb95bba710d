"""Clipping in view space, float64, all at once: triangles that cross the near plane or leave the guard band.

Two triangles that share an edge stay watertight: they cut it in the very same point.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int32, Int64
from torch import Tensor

from cloak_core.render.visibility.polygons import cut
from cloak_core.render.visibility.projection import GRID, GUARD, snap


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
    polygon, size = cut(corners, corners[:, 2] - near)
    for axis, center in ((0, width / 2), (1, height / 2)):
        reach = GUARD / GRID - center  # the guard band is centred on the image's corner, the view on its middle
        for sign in (1.0, -1.0):
            polygon, now = cut(polygon, polygon[:, axis] * focal * sign + polygon[:, 2] * reach)
            size = torch.minimum(now, size * len(polygon))  # what was nothing stays that
    part = torch.arange(1, len(polygon) - 1, device=corners.device).unsqueeze(-1)
    fan, owner = (part < size - 1).nonzero(as_tuple=True)
    fan = fan + 1
    pieces = torch.stack([polygon[corner, :, owner] for corner in (torch.zeros_like(fan), fan, fan + 1)])
    x, y = snap(pieces.unbind(-1), focal[owner], near[owner], width, height)
    nearness = (near[owner] / pieces[..., 2]).view(-1)
    return Soup(x, y, torch.arange(x.numel(), device=x.device).view(x.shape), nearness), owner
