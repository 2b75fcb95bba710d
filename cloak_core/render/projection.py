"""Perspective projection of vertices to the snapped screen, in float64."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float64
from torch import Tensor

from cloak_core.render.backend import backend
from cloak_core.render.types import Screen
from cloak_core.scene.cameras import Camera, Vector


def project(vertices: Float64[Tensor, "B 3 V"], cameras: Sequence[Camera], pivots: Sequence[Vector]) -> Screen:
    """Project one pose per camera. Raises `InputError` naming the first vertex that is not finite."""
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
    return backend(vertices.device).project_rows(vertices, rows, width, height)
