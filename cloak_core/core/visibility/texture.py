"""Textures: what a picture says about a surface, at points of it. Nothing here is differentiated."""

from __future__ import annotations

import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

INSET = 0.02
"""Least weight of a corner: how far, in shares of a triangle's height, points stay off its sides."""


def texture_coordinates(
    corner_uv: Float32[Tensor, "2 3 Q"], b1: Float32[Tensor, " Q"], b2: Float32[Tensor, " Q"], inset: float = INSET
) -> Float32[Tensor, "2 Q"]:
    """Compute texture coordinates of points given by the weights of their triangles' corners 1 and 2.

    Points may lie a little outside (the middle of a pixel's part of a triangle is that of its extent); they are moved
    into the triangle, and off its border by `inset`, so that no other chart's colours are looked up.
    """
    weight = torch.stack([1 - b1 - b2, b1, b2]).clamp(min=inset)
    weight = weight / weight.sum(0)
    return (corner_uv * weight).sum(1)


def look_up(texture: UInt8[Tensor, "h w 3"], uv: Float32[Tensor, "2 N"]) -> Float32[Tensor, "N 3"]:
    """Look up colours in [0, 1] at texture coordinates (v up), between the four texels around; the picture repeats."""
    height, width = texture.shape[:2]
    x, y = (uv[0] % 1) * width - 0.5, (1 - uv[1] % 1) * height - 0.5
    left, top = x.floor(), y.floor()
    fx, fy = x - left, y - top
    # Divisions of small integers take a quarter of the time.
    column, row = left.to(torch.int32), top.to(torch.int32)
    columns, rows = [(column + k) % width for k in (0, 1)], [(row + k) % height * width for k in (0, 1)]
    shares = ((1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy)
    total = 0
    for k, share in enumerate(shares):
        texel = texture.view(-1, 3).index_select(0, rows[k // 2] + columns[k % 2])
        total = total + texel * share.unsqueeze(1)
    return total / 255
