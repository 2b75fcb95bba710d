"""The snapped screen: integer coordinates in units of 2^-16 pixel.

View space has x to the right, y up and z forward, metres. On the screen x points right and y down from the image's top
left corner; the centre of pixel (0, 0) is at (2^15, 2^15). Elementwise arithmetic only, one rounding per operation, in
a fixed order: every device and every batch computes the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float64, Int32
from torch import Tensor

from cloak_core.files.errors import InputError
from cloak_core.render.types import Coordinates, Screen

GRID = 1 << 16
"""Snapping grid: positions per pixel, along each axis."""
GUARD = 8192 * GRID
"""Guard band: snapped coordinates stay within [-GUARD, GUARD], so that edge functions fit into int64."""


def screen_of(
    width: int,
    height: int,
    view: Coordinates,
    x: Int32[Tensor, "B V"],
    y: Int32[Tensor, "B V"],
    inverse_depth: Tensor,
    extremes: Sequence[float],
    focal: Tensor,
    near: Tensor,
) -> Screen:
    """Make the screen of projected vertices.

    extremes: least and greatest snapped x, least and greatest y, and the least distance beyond the near plane.
    """
    inside = None
    if extremes[4] < 0 or max(abs(value) for value in extremes[:4]) > GUARD / 2:
        screen_x, screen_y = rounded(view, focal, near, width, height)
        inside = (view[2] >= near) & (torch.maximum(screen_x.abs(), screen_y.abs()) <= GUARD / 2)
    bounds = tuple(int(min(max(value, -GUARD), GUARD)) for value in extremes[:4])
    return Screen(width, height, view, x, y, inverse_depth, inside, bounds, focal, near)


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


def not_finite(vertices: Float64[Tensor, "B 3 V"]) -> InputError:
    """Make the error that names a vertex that cannot be projected."""
    # The largest float32 projects without overflow, so the culprit is a vertex of larger float64.
    bad = ~(vertices.abs() <= 1e100)
    if not bad.any():
        return InputError("a camera whose numbers are too far apart to project anything")
    view, axis, vertex = bad.nonzero()[0].tolist()
    value = vertices[view, axis, vertex].item()
    return InputError(f"vertex {vertex} of view {view}: coordinate {'xyz'[axis]} is {value}, not a usable number")
