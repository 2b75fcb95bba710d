"""Fragments to a view's matrix, as numba loops: light at every fragment, then a row for each pixel."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.core.view import Fragments, Screen, Surface, View
from cloak_core.core.visibility.compiled import arrays, loop
from cloak_core.core.visibility.cpu.shading import light_all, material_of


def build_view(
    found: Fragments,
    screen: Screen,
    surface: Surface,
    normals: Float32[Tensor, "3 V"],
    light_position: Float32[Tensor, " 3"],
) -> View:
    """See `Backend.build_view`."""
    textured = surface.corner_uv is not None
    space = np.stack([axis[0].numpy() for axis in screen.view])
    camera = float(screen.focal), screen.width / 2, screen.height / 2
    fragments = arrays(found.pixel, found.triangle, found.area, found.x, found.y)
    corner, face_of, normal, position = arrays(surface.triangles, surface.face, normals, light_position)
    uv_of = arrays(surface.corner_uv)[0] if textured else np.empty((2, 3, 0), np.float32)
    about = corner, space, camera, normal, position, material_of(surface.light), uv_of, face_of, surface.by_face
    *rows, uv = map(torch.from_numpy, _matrix(*fragments, *about))
    return View(screen.height, screen.width, *rows, uv if textured else None)


@loop
def _matrix(
    pixel, triangle, area, x, y, corner, space, camera, normals, light, material, uv_of, face_of, by_face
):  # fmt: skip
    """The rows of a view's matrix from its fragments, sorted by pixel: pixel, coverage and highlight of each row; row
    offsets, face, weight and texture coordinates of its entries. The arguments are those of `light_all` and `_fold`."""
    out = np.empty((4 if uv_of.shape[2] else 2, len(triangle)), np.float32)
    light_all(triangle, area, x, y, corner, space, camera, normals, light, material, uv_of, out)
    return _fold(pixel, area, out[1], face_of[triangle], out[0], out[2:], by_face)


@loop
def _fold(pixel, area, highlight, face, weight, uv, by_face):
    """Fragments to the rows of a matrix, one for each pixel (ascending).

    by_face: within a pixel, one entry for each face, ascending; else one for each fragment, as they come.
    """
    count = len(pixel)
    pixels, crow, column = np.empty(count, np.int64), np.empty(count + 1, np.int64), np.empty(count, np.int64)
    coverage, specular, value = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    rows = entries = begin = 0
    for i in range(count):
        if i == 0 or pixel[i] != pixel[i - 1]:
            pixels[rows] = pixel[i]
            coverage[rows] = specular[rows] = 0
            crow[rows] = begin = entries
            rows += 1
        coverage[rows - 1] += area[i]
        specular[rows - 1] += highlight[i]
        at = entries
        if by_face:
            at = begin
            while at < entries and column[at] < face[i]:
                at += 1
            if at < entries and column[at] == face[i]:
                value[at] += weight[i]
                continue
            for j in range(entries, at, -1):
                column[j], value[j] = column[j - 1], value[j - 1]
        column[at], value[at] = face[i], weight[i]
        entries += 1
    crow[rows] = entries
    # Copies: what is not used of these arrays should not stay in memory.
    pixels, coverage, specular = pixels[:rows].copy(), coverage[:rows].copy(), specular[:rows].copy()
    return pixels, coverage, specular, crow[: rows + 1].copy(), column[:entries].copy(), value[:entries].copy(), uv
