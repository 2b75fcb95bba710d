"""Vertices to the snapped screen, in torch (screen.py says how)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float64
from torch import Tensor

from cloak_core.render.screen import integers, not_finite, rounded, screen_of
from cloak_core.render.types import Screen


def project_rows(vertices: Float64[Tensor, "B 3 V"], rows: list[tuple[float, ...]], width: int, height: int) -> Screen:
    """See `Backend.project_rows`."""
    values = torch.tensor(rows, dtype=torch.float64).T.unsqueeze(-1).to(vertices.device).unbind(0)
    position, right, up, back = (values[i : i + 3] for i in range(0, 12, 3))
    focal, near = values[12:]
    x, y, z = (axis - p for axis, p in zip(vertices.unbind(1), position, strict=True))
    # Cameras on an orbit never roll: `right` has no y.
    view = (x * right[0] + z * right[2], _dot(x, y, z, up), -_dot(x, y, z, back))
    screen_x, screen_y = rounded(view, focal, near, width, height)
    inverse_depth = near / view[2].clamp(min=near)
    extremes = torch.stack([*torch.aminmax(screen_x), *torch.aminmax(screen_y), (view[2] - near).amin()]).tolist()
    if not all(math.isfinite(value) for value in extremes):
        raise not_finite(vertices)
    x, y = integers(screen_x), integers(screen_y)
    return screen_of(width, height, view, x, y, inverse_depth, extremes, focal, near)


def _dot(x: Tensor, y: Tensor, z: Tensor, axis: Sequence[Tensor]) -> Tensor:
    return (x * axis[0]).add_(y * axis[1]).add_(z * axis[2])
