"""The snapped screen: integer coordinates in units of 2^-16 pixel, and depth and id packed into one integer.

View space has x to the right, y up and z forward, metres. On the screen x points right and y down from the image's top
left corner; the centre of pixel (0, 0) is at (2^15, 2^15). Elementwise arithmetic only, one rounding per operation, in
a fixed order: every device and every batch computes the same bits.

A sample holds one integer, depth above the triangle's id; the least is the nearest. Depth is a 39-bit integer,
trunc(n * 2^39), of the inverse depth n = (e1 * ((n1 - n0) / A) + e2 * ((n2 - n0) / A)) + n0 in float64. Corner 0 is the
topmost one (of two the right one), corners 1 and 2 follow clockwise on the screen, and ei is the edge function that is
A at corner i. The result does not depend on the order in which a triangle lists its corners: identical triangles tie,
and ties go to the lower id.
"""

from __future__ import annotations

from functools import cache

import torch
from jaxtyping import Float64, Int32, Int64
from torch import Tensor

ID_BITS = 24
DEPTH_BITS = 39
LIMIT = (1 << DEPTH_BITS) - 1
EMPTY = (1 << 63) - 1
"""The packed value where nothing is."""


def triangle_ids(packed: Int64[Tensor, "*N"]) -> Int64[Tensor, "*N"]:
    """Unpack the triangle ids, -1 for `EMPTY`."""
    return (packed << (64 - ID_BITS)) >> (64 - ID_BITS)


GRID = 1 << 16
"""Snapping grid: positions per pixel, along each axis."""
GUARD = 8192 * GRID
"""Guard band: snapped coordinates stay within [-GUARD, GUARD], so that edge functions fit into int64."""


def rounded(
    view: Float64[Tensor, "*B 3 N"], focal: Tensor, near: Tensor, width: int, height: int
) -> Float64[Tensor, "*B 2 N"]:
    """Project points to whole numbers of grid units, unbounded; focal and near are of each point or of all."""
    middle, direction = _frame(width, height, view.device)
    scale = focal * GRID / view[..., 2:, :].clamp(min=near)
    return torch.addcmul(middle, direction, view[..., :2, :] * scale).round_()  # the factor is 1 or -1: one rounding


@cache
def _frame(width: int, height: int, device: torch.device) -> tuple[Float64[Tensor, "2 1"], Float64[Tensor, "2 1"]]:
    """Return the image's middle in grid units, and which way each axis of the view runs on the screen.

    Kept: a copy to a device waits for it.
    """
    middle = torch.tensor([[width], [height]], dtype=torch.float64) * (GRID // 2)
    return middle.to(device), torch.tensor([[1.0], [-1.0]], dtype=torch.float64).to(device)


def integers(position: Tensor) -> Int32[Tensor, ...]:
    """Convert grid units to int32, clamped to the guard band."""
    return position.clamp(-GUARD, GUARD).to(torch.int32)
