"""World space to the snapped screen: perspective projection in float64, rounded to a grid of 2^-16 pixel.

Elementwise arithmetic only, one rounding per operation, in a fixed order: every device and every batch computes the
same bits. View space has x to the right, y up and z forward, metres. Screen coordinates are integers in units of 2^-16
pixel, x to the right and y down from the image's top left corner; the centre of pixel (0, 0) is at (2^15, 2^15).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float64, Int32
from torch import Tensor

from cloak_core.files.errors import InputError
from cloak_core.render.seam import steps
from cloak_core.scene.cameras import Camera, Vector

GRID = 1 << 16
"""Snapping grid: positions per pixel, along each axis."""
GUARD = 8192 * GRID
"""Guard band: snapped coordinates stay within [-GUARD, GUARD], so that edge functions fit into int64."""


@dataclass(frozen=True)
class Window:
    """A part of the image, in pixels: columns x0 <= x < x1, rows y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int


Coordinates = tuple[Tensor, Tensor, Tensor]
"""x, y and z of points, float64, all of one shape."""


@dataclass(frozen=True)
class Screen:
    """B views of V vertices: view space, and the snapped screen. All cameras of a batch share one image size."""

    width: int
    height: int
    view: Coordinates
    """View space coordinates [B, V], metres."""
    x: Int32[Tensor, "B V"]
    y: Int32[Tensor, "B V"]
    nearness: Float64[Tensor, "B V"]
    """Near plane over view z: 1 at the near plane, towards 0 far away; linear on the screen along any triangle."""
    safe: Bool[Tensor, "B V"] | None
    """Which vertices lie in front of the near plane and well inside the guard band (None: all). x, y and nearness mean
    nothing at the others; triangles that have one of those need clipping."""
    bounds: tuple[int, int, int, int]
    """Least and greatest x, least and greatest y of all vertices; (0, 0, 0, 0) where there are none."""
    focal: Float64[Tensor, "B 1"]
    near: Float64[Tensor, "B 1"]

    def part(self, views: slice) -> Screen:
        """Some of its views."""
        rows = lambda t: None if t is None else t[views]
        return replace(
            self,
            view=tuple(axis[views] for axis in self.view),
            **{name: rows(getattr(self, name)) for name in ("x", "y", "nearness", "safe", "focal", "near")},
        )


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
    return steps(vertices.device).project(vertices, rows, width, height)


def project_rows(vertices: Float64[Tensor, "B 3 V"], rows: list[tuple[float, ...]], width: int, height: int) -> Screen:
    """`project` on any device. rows: each camera's position, axes, focal length and near plane."""
    values = torch.tensor(rows, dtype=torch.float64).T.unsqueeze(-1).to(vertices.device).unbind(0)
    position, right, up, back = (values[i : i + 3] for i in range(0, 12, 3))
    focal, near = values[12:]
    x, y, z = (axis - p for axis, p in zip(vertices.unbind(1), position, strict=True))
    # Cameras on an orbit never roll: `right` has no y.
    view = (x * right[0] + z * right[2], _dot(x, y, z, up), -_dot(x, y, z, back))
    screen_x, screen_y = _screen(view, focal, near, width, height)
    nearness = near / view[2].clamp(min=near)
    extremes = torch.stack([*torch.aminmax(screen_x), *torch.aminmax(screen_y), (view[2] - near).amin()]).tolist()
    if not all(math.isfinite(value) for value in extremes):
        raise not_finite(vertices)
    x, y = _integers(screen_x), _integers(screen_y)
    return screen_of(width, height, view, x, y, nearness, extremes, focal, near)


def screen_of(
    width: int,
    height: int,
    view: Coordinates,
    x: Int32[Tensor, "B V"],
    y: Int32[Tensor, "B V"],
    nearness: Tensor,
    extremes: Sequence[float],
    focal: Tensor,
    near: Tensor,
) -> Screen:
    """The screen of projected vertices. extremes: of snapped x and y, and the least distance before the near plane."""
    safe = None
    if extremes[4] < 0 or max(abs(value) for value in extremes[:4]) > GUARD / 2:
        screen_x, screen_y = _screen(view, focal, near, width, height)
        safe = (view[2] >= near) & (torch.maximum(screen_x.abs(), screen_y.abs()) <= GUARD / 2)
    bounds = tuple(int(min(max(value, -GUARD), GUARD)) for value in extremes[:4])
    return Screen(width, height, view, x, y, nearness, safe, bounds, focal, near)


def snap(view: Coordinates, focal: Tensor, near: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Snapped screen x and y, int32, of points in view space that lie before the near plane and in the guard band."""
    x, y = _screen(view, focal, near, width, height)
    return _integers(x), _integers(y)


def _screen(view: Coordinates, focal: Tensor, near: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Whole numbers of grid units, float64."""
    scale = focal * GRID / view[2].clamp(min=near)
    x = (view[0] * scale).add_(width * (GRID // 2)).round_()
    return x, (height * (GRID // 2) - view[1] * scale).round_()


def _integers(position: Tensor) -> Int32[Tensor, ...]:
    return position.clamp(-GUARD, GUARD).to(torch.int32)


def _dot(x: Tensor, y: Tensor, z: Tensor, axis: Sequence[Tensor]) -> Tensor:
    return (x * axis[0]).add_(y * axis[1]).add_(z * axis[2])


def not_finite(vertices: Float64[Tensor, "B 3 V"]) -> InputError:
    """The error that names a vertex that cannot be projected."""
    # The largest float32 projects without overflow, so what is left to blame is a vertex of larger float64.
    bad = ~(vertices.abs() <= 1e100)
    if not bad.any():
        return InputError("a camera whose numbers are too far apart to project anything")
    view, axis, vertex = bad.nonzero()[0].tolist()
    value = vertices[view, axis, vertex].item()
    return InputError(f"vertex {vertex} of view {view}: coordinate {'xyz'[axis]} is {value}, not a usable number")
