"""Vertices to the snapped screen, as a numba loop: the operations of torch/projection.py, in their order."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from cloak_core.render.compiled import loop
from cloak_core.render.screen import GRID, GUARD, not_finite, screen_of
from cloak_core.render.types import Screen


def project_rows(vertices: Float64[Tensor, "B 3 V"], rows: list[tuple[float, ...]], width: int, height: int) -> Screen:
    """See `Backend.project_rows`."""
    batch, _, count = vertices.shape
    view, inverse_depth = np.empty((3, batch, count)), np.empty((batch, count))
    x, y = np.empty((2, batch, count), np.int32)
    found, middle = [], (width * (GRID / 2), height * (GRID / 2))
    for b, row in enumerate(rows):
        position, right, up, back = (row[i : i + 3] for i in range(0, 12, 3))
        out = view[:, b], x[b], y[b], inverse_depth[b]
        found.append(
            _project(vertices[b].numpy(), position, right, up, back, *row[12:], middle, GRID, float(GUARD), *out)
        )
    if not all(finite for *_, finite in found):
        raise not_finite(vertices)
    left, right, top, bottom, front, _ = zip(*found, strict=True)
    extremes = min(left), max(right), min(top), max(bottom), min(front)
    focal, near = torch.tensor([row[12:] for row in rows], dtype=torch.float64).T.unsqueeze(-1)
    x, y, inverse_depth = (torch.from_numpy(t) for t in (x, y, inverse_depth))
    return screen_of(width, height, torch.from_numpy(view).unbind(0), x, y, inverse_depth, extremes, focal, near)


@loop
def _project(vertices, position, right, up, back, focal, near, middle, grid, guard, view, x, y, inverse_depth):
    """Project one view: view space into `view` [3, V], snapped x and y [V], int32, and inverse_depth [V].

    vertices: [3, V]; position, right, up, back: of the camera; middle: of the image, grid units. Returns least and
    greatest x, least and greatest y, the least distance before the near plane, and whether every number is finite.
    """
    left, most_right, top, bottom, front = np.inf, -np.inf, np.inf, -np.inf, np.inf
    finite = True
    for i in range(vertices.shape[1]):
        px, py, pz = vertices[0, i] - position[0], vertices[1, i] - position[1], vertices[2, i] - position[2]
        vx = px * right[0] + pz * right[2]
        vy = px * up[0] + py * up[1] + pz * up[2]
        vz = -(px * back[0] + py * back[1] + pz * back[2])
        ahead = max(vz, near)
        scale = focal * grid / ahead
        sx, sy = np.rint(vx * scale + middle[0]), np.rint(middle[1] - vy * scale)
        finite &= np.isfinite(sx) & np.isfinite(sy) & np.isfinite(vz)
        left, most_right, top, bottom = min(left, sx), max(most_right, sx), min(top, sy), max(bottom, sy)
        front = min(front, vz - near)
        view[0, i], view[1, i], view[2, i] = vx, vy, vz
        x[i], y[i] = min(max(sx, -guard), guard), min(max(sy, -guard), guard)
        inverse_depth[i] = near / ahead
    return left, most_right, top, bottom, front, finite
