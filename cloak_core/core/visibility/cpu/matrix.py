"""Fragments to a view's matrix, as numba loops: light at every fragment, then a row for each pixel."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.core.linear import SparseMap
from cloak_core.core.view import Fragments, Screen, Surface, View
from cloak_core.core.visibility.compiled import arrays, loop
from cloak_core.core.visibility.cpu.shading import light_all, material_of


def build_view(
    fragments: Fragments,
    screen: Screen,
    surface: Surface,
    normals: Float32[Tensor, "3 V"],
    light_position: Float32[Tensor, " 3"],
) -> View:
    """See `torch/matrix.py`."""
    space = screen.view[0].numpy()
    camera = float(screen.focal), screen.width / 2, screen.height / 2
    columns = arrays(fragments.pixel, fragments.triangle, fragments.area, fragments.x, fragments.y)
    corner, face_of, normal, position = arrays(surface.triangles, surface.face, normals, light_position)
    maps = [surface.corner_uv, surface.corner_cloth]
    uv_of, cloth_of = (np.empty((2, 3, 0), np.float32) if corners is None else arrays(corners)[0] for corners in maps)
    about = corner, space, camera, normal, position, material_of(surface.light), uv_of, cloth_of
    made = _matrix(*columns, *about, face_of, surface.by_face)
    pixels, coverage, specular, crow, face, weight, uv, cloth = map(torch.from_numpy, made)
    return View(
        screen.height,
        screen.width,
        pixels,
        coverage,
        specular,
        SparseMap(crow, face, weight, surface.face_count),
        uv if len(uv) else None,
        cloth if len(cloth) else None,
    )


@loop
def _matrix(
    pixel, triangle, area, x, y, corner, space, camera, normals, light, material, uv_of, cloth_of, face_of, by_face
):  # fmt: skip
    """The rows of a view's matrix from its fragments, sorted by pixel: pixel, coverage and highlight of each row; row
    offsets, face, weight, texture coordinates and place on a cloth of its entries. The arguments are those of
    `light_all` and `_fold`."""
    uv_rows, cloth_rows = 2 if uv_of.shape[2] else 0, 4 if cloth_of.shape[2] else 0
    out = np.empty((2, len(triangle)), np.float32)
    uv = np.empty((uv_rows, len(triangle)), np.float32)
    cloth = np.empty((cloth_rows, len(triangle)), np.float32)
    light_all(triangle, area, x, y, corner, space, camera, normals, light, material, uv_of, cloth_of, out, uv, cloth)
    return (*_fold(pixel, area, out[1], face_of[triangle], out[0], by_face), uv, cloth)


@loop
def _fold(pixel, area, highlight, face, weight, by_face):
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
                column[j] = column[j - 1]
                value[j] = value[j - 1]
        column[at] = face[i]
        value[at] = weight[i]
        entries += 1
    crow[rows] = entries
    # Copies: what is not used of these arrays should not stay in memory.
    pixels, coverage, specular = pixels[:rows].copy(), coverage[:rows].copy(), specular[:rows].copy()
    return pixels, coverage, specular, crow[: rows + 1].copy(), column[:entries].copy(), value[:entries].copy()
