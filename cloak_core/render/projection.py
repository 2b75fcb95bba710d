"""World space to the snapped screen: perspective projection in float64, rounded to a grid of 2^-16 pixel.

Elementwise arithmetic only, one rounding per operation, in a fixed order: every device and every batch computes the
same bits. View space has x to the right, y up and z forward, metres. Screen coordinates are integers in units of 2^-16
pixel, x to the right and y down from the image's top left corner; the centre of pixel (0, 0) is at (2^15, 2^15).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float64, Int32
from torch import Tensor

from cloak_core.errors import InputError
from cloak_core.scene.cameras import Camera, Vector

GRID = 1 << 16
"""Snapping grid: positions per pixel, along each axis."""
GUARD = 8192 * GRID
"""Guard band: snapped coordinates stay within [-GUARD, GUARD], so that edge functions fit into int64."""


@dataclass(frozen=True)
class Screen:
    """B views of V vertices: view space, and the snapped screen where it is `safe`.

    All cameras of a batch share one image size.
    """

    width: int
    height: int
    view: Float64[Tensor, "3 B V"]
    """View space coordinates, metres."""
    x: Int32[Tensor, "B V"]
    y: Int32[Tensor, "B V"]
    nearness: Float64[Tensor, "B V"]
    """Near plane over view z: 1 at the near plane, towards 0 far away; linear on the screen along any triangle."""
    safe: Bool[Tensor, "B V"]
    """In front of the near plane and well inside the guard band. Triangles with another vertex need clipping first."""
    focal: Float64[Tensor, "B 1"]
    near: Float64[Tensor, "B 1"]


def project(vertices: Float64[Tensor, "B 3 V"], cameras: Sequence[Camera], pivots: Sequence[Vector]) -> Screen:
    """Project one pose per camera. Raises `InputError` naming the first vertex that is not finite."""
    width, height = cameras[0].width, cameras[0].height
    if any((camera.width, camera.height) != (width, height) for camera in cameras):
        raise ValueError("the cameras of one batch must share one image size")
    _check_finite(vertices)
    device = vertices.device
    column = lambda values: torch.tensor(values, dtype=torch.float64).to(device).unsqueeze(-1)
    focal = column([camera.focal for camera in cameras])
    near = column([camera.near_plane for camera in cameras])
    positions = [camera.position(pivot) for camera, pivot in zip(cameras, pivots, strict=True)]
    offset = [vertices[:, i] - column([p[i] for p in positions]) for i in range(3)]
    view = torch.stack([
        _dot(offset, [column([c.axes[axis][i] * sign for c in cameras]) for i in range(3)])
        for axis, sign in ((0, 1.0), (1, 1.0), (2, -1.0))
    ])  # fmt: skip
    x, y, safe = snap(view, focal, near, width, height)
    return Screen(width, height, view, x, y, near / view[2], safe, focal, near)


def snap(
    view: Float64[Tensor, "xyz=3 *N"], focal: Tensor, near: Tensor, width: int, height: int
) -> tuple[Int32[Tensor, "*N"], Int32[Tensor, "*N"], Bool[Tensor, "*N"]]:
    """Snapped screen x and y of points in view space, and whether they are meaningful (see `Screen.safe`)."""
    scale = focal / view[2] * GRID
    x = torch.round(view[0] * scale + width * (GRID / 2))
    y = torch.round(height * (GRID / 2) - view[1] * scale)
    safe = (view[2] >= near) & (torch.maximum(x.abs(), y.abs()) <= GUARD / 2)
    x = torch.nan_to_num(x).clamp_(-GUARD, GUARD).to(torch.int32)
    y = torch.nan_to_num(y).clamp_(-GUARD, GUARD).to(torch.int32)
    return x, y, safe


def _dot(a: Sequence[Tensor], b: Sequence[Tensor]) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _check_finite(vertices: Float64[Tensor, "B 3 V"]) -> None:
    if vertices.numel() and not torch.isfinite(vertices.abs().amax()):  # a NaN survives amax
        view, axis, vertex = (~torch.isfinite(vertices)).nonzero()[0].tolist()
        value = vertices[view, axis, vertex].item()
        raise InputError(f"vertex {vertex} of view {view}: coordinate {'xyz'[axis]} is {value}, not a finite number")
