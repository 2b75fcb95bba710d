"""The snapped screen: integer coordinates in units of 2^-16 pixel.

View space has x to the right, y up and z forward, metres. On the screen x points right and y down from the image's top
left corner; the centre of pixel (0, 0) is at (2^15, 2^15). Elementwise arithmetic only, one rounding per operation, in
a fixed order: every device and every batch computes the same bits.
"""

from __future__ import annotations

import torch
from jaxtyping import Int32
from torch import Tensor

from cloak_core.core.view import Coordinates

GRID = 1 << 16
"""Snapping grid: positions per pixel, along each axis."""
GUARD = 8192 * GRID
"""Guard band: snapped coordinates stay within [-GUARD, GUARD], so that edge functions fit into int64."""


def snap(view: Coordinates, focal: Tensor, near: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Snap points in view space, before the near plane and in the guard band, to the screen: x and y, int32."""
    x, y = rounded(view, focal, near, width, height)
    return integers(x), integers(y)


def rounded(view: Coordinates, focal: Tensor, near: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Project points to whole numbers of grid units, float64, unbounded."""
    scale = focal * GRID / view[2].clamp(min=near)
    x = (view[0] * scale).add_(width * (GRID // 2)).round_()
    return x, (height * (GRID // 2) - view[1] * scale).round_()


def integers(position: Tensor) -> Int32[Tensor, ...]:
    """Convert grid units to int32, clamped to the guard band."""
    return position.clamp(-GUARD, GUARD).to(torch.int32)
