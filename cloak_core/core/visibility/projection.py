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
    rows = []
    for camera, pivot in zip(cameras, pivots, strict=True):
        # The x of the axes right, up and forward in the world, then their y, then their z.
        axes = [value for right, up, back in zip(*camera.axes, strict=True) for value in (right, up, -back)]
        rows.append((*camera.position(pivot), *axes, camera.focal, camera.near_plane))
    if not vertices.shape[2]:
        nothing = vertices.new_zeros(len(rows), 0)
        scale = vertices.new_ones(len(rows), 1)
        whole = nothing.to(torch.int32)
        return Screen(width, height, vertices, whole, whole, nothing, None, (0, 0, 0, 0), scale, scale)
    values = torch.tensor(rows, dtype=torch.float64).to(vertices.device).unsqueeze(-1)
    position, axes, focal, near = values[:, :3], values[:, 3:12].unflatten(1, (3, 3)), values[:, 12:13], values[:, 13:]
    x, y, z = (vertices - position).split(1, 1)
    view = (x * axes[:, 0]).add_(y * axes[:, 1]).add_(z * axes[:, 2])
    depth = view[:, 2]
    screen = rounded(view, focal, near, width, height)
    low, high = torch.aminmax(screen, dim=-1)
    focal, near = focal[:, 0], near[:, 0]
    extremes = torch.cat([low.amin(0), high.amax(0), (depth - near).amin().view(1)]).tolist()
    if not all(math.isfinite(value) for value in extremes):
        raise _not_finite(vertices)
    x0, y0, x1, y1, front = extremes
    inside = None
    if front < 0 or max(map(abs, extremes[:4])) > GUARD / 2:
        inside = (depth >= near) & (screen.abs().amax(1) <= GUARD / 2)
    bounds = tuple(int(min(max(value, -GUARD), GUARD)) for value in (x0, x1, y0, y1))
    x, y = integers(screen).unbind(1)
    return Screen(width, height, view, x, y, near / depth.clamp(min=near), inside, bounds, focal, near)


def _not_finite(vertices: Float64[Tensor, "B 3 V"]) -> InputError:
    """Make the error that names a vertex that cannot be projected."""
    # The largest float32 projects without overflow, so the culprit is a vertex of larger float64.
    bad = ~(vertices.abs() <= 1e100)
    if not bad.any():
        return InputError("a camera whose numbers are too far apart to project anything")
    view, axis, vertex = bad.nonzero()[0].tolist()
    value = vertices[view, axis, vertex].item()
    return InputError(f"vertex {vertex} of view {view}: coordinate {'xyz'[axis]} is {value}, not a usable number")
