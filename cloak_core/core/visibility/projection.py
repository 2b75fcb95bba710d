"""Vertices to the snapped screen (screen.py says how)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float64
from torch import Tensor

from cloak_core.core.cameras import Camera, Vector
from cloak_core.core.view import Screen
from cloak_core.core.visibility.screen import GUARD, integers, rounded
from cloak_core.files.errors import InputError


def project(vertices: Float64[Tensor, "B 3 V"], cameras: Sequence[Camera], pivots: Sequence[Vector]) -> Screen:
    """Project one pose per camera to the snapped screen, in float64.

    Raises `InputError` naming the first vertex that is not finite.
    """
    width, height = cameras[0].width, cameras[0].height
    if any((camera.width, camera.height) != (width, height) for camera in cameras):
        raise ValueError("the cameras of one batch must share one image size")
    rows = [
        (*camera.position(pivot), *camera.axes[0], *camera.axes[1], *camera.axes[2], camera.focal, camera.near_plane)
        for camera, pivot in zip(cameras, pivots, strict=True)
    ]
    if not vertices.shape[2]:
        nothing, scale = vertices.new_zeros(len(rows), 0), vertices.new_ones(len(rows), 1)
        whole = nothing.to(torch.int32)
        return Screen(width, height, (nothing,) * 3, whole, whole, nothing, None, (0, 0, 0, 0), scale, scale)
    values = torch.tensor(rows, dtype=torch.float64).T.unsqueeze(-1).to(vertices.device).unbind(0)
    position, right, up, back = (values[i : i + 3] for i in range(0, 12, 3))
    focal, near = values[12:]
    x, y, z = (axis - p for axis, p in zip(vertices.unbind(1), position, strict=True))
    # Cameras on an orbit never roll: `right` has no y.
    view = (x * right[0] + z * right[2], _dot(x, y, z, up), -_dot(x, y, z, back))
    screen_x, screen_y = rounded(view, focal, near, width, height)
    extremes = torch.stack([*torch.aminmax(screen_x), *torch.aminmax(screen_y), (view[2] - near).amin()]).tolist()
    if not all(math.isfinite(value) for value in extremes):
        raise _not_finite(vertices)
    *edges, front = extremes
    inside = None
    if front < 0 or max(map(abs, edges)) > GUARD / 2:
        inside = (view[2] >= near) & (torch.maximum(screen_x.abs(), screen_y.abs()) <= GUARD / 2)
    bounds = tuple(int(min(max(value, -GUARD), GUARD)) for value in edges)
    inverse_depth, x, y = near / view[2].clamp(min=near), integers(screen_x), integers(screen_y)
    return Screen(width, height, view, x, y, inverse_depth, inside, bounds, focal, near)


def _dot(x: Tensor, y: Tensor, z: Tensor, axis: Sequence[Tensor]) -> Tensor:
    return (x * axis[0]).add_(y * axis[1]).add_(z * axis[2])


def _not_finite(vertices: Float64[Tensor, "B 3 V"]) -> InputError:
    """Make the error that names a vertex that cannot be projected."""
    # The largest float32 projects without overflow, so the culprit is a vertex of larger float64.
    bad = ~(vertices.abs() <= 1e100)
    if not bad.any():
        return InputError("a camera whose numbers are too far apart to project anything")
    view, axis, vertex = bad.nonzero()[0].tolist()
    value = vertices[view, axis, vertex].item()
    return InputError(f"vertex {vertex} of view {view}: coordinate {'xyz'[axis]} is {value}, not a usable number")
