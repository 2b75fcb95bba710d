"""Fragments to a view's matrix, as numba loops: light at every fragment (float64), then a row for each pixel.

torch/matrix.py gives the formula of the light.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.core.linear import SparseMap
from cloak_core.core.view import Fragments, Screen, Surface, View
from cloak_core.core.visibility.compiled import arrays, loop
from cloak_core.core.visibility.settings import Light
from cloak_core.core.visibility.texture import INSET

_TINY = 1e-20
UNSEEN = 1e-12
"""Share of a highlight that is left out: powers take time."""


def material_of(light: Light) -> tuple[float, ...]:
    """Ambient, diffuse, specular, shininess; and the least cosine whose power is not below `UNSEEN`."""
    least = UNSEEN ** (1 / light.shininess) if light.shininess > 0 else -np.inf
    return float(light.ambient), float(light.diffuse), float(light.specular), float(light.shininess), float(least)


@loop
def light_all(
    triangle, area, x, y, corner, space, camera, normals, light, material, uv_of, cloth_of, out, uv, cloth
):  # fmt: skip
    """Light each fragment: weight and highlight into `out` [2, N], any texture coordinates into `uv` [2, N], any place
    and extent on a cloth into `cloth` [4, N].

    x, y: where each fragment is lit, pixels; space: view space coordinates [3, V]; camera: focal length and the
    image's middle, pixels; normals [3, V] and light [3]: in view space; material: see `material_of`; uv_of, cloth_of:
    coordinates of the corners [2, 3, T], or [2, 3, 0] where there are none.
    """
    focal, middle_x, middle_y = camera
    ax, ay, az = space[0], space[1], space[2]
    nx_of, ny_of, nz_of = normals[0], normals[1], normals[2]
    lx, ly, lz = light[0], light[1], light[2]
    step = 1 / focal
    textured, laid = uv_of.shape[2] > 0, cloth_of.shape[2] > 0
    for i in range(len(triangle)):
        t = triangle[i]
        p, q, r = corner[0, t], corner[1, t], corner[2, t]
        # Numbers, not slices of arrays: those are counted each time one is made.
        a, b, c = (ax[p], ay[p], az[p]), (ax[q], ay[q], az[q]), (ax[r], ay[r], az[r])
        crosses = _cross(b, c), _cross(c, a), _cross(a, b)
        dx, dy = (x[i] - middle_x) * step, (middle_y - y[i]) * step
        w0, w1, w2 = _weights(crosses, dx, dy)
        total = w0 + w1 + w2
        if total == 0:  # seen exactly edge-on: its first corner stands in
            w0, w1, w2 = 1.0, 0.0, 0.0
            depth = az[p]
        else:
            scale = 1 / total
            w0, w1, w2 = w0 * scale, w1 * scale, w2 * scale
            depth = w0 * az[p] + w1 * az[q] + w2 * az[r]
        if textured:
            uv[0, i], uv[1, i] = _texture_coordinates(uv_of, t, w1, w2, INSET)
        if laid:
            cloth[0, i], cloth[1, i] = _texture_coordinates(cloth_of, t, w1, w2, 0.0)
            side = np.sqrt(area[i]) * step
            for axis in range(2):
                corners = cloth_of[axis, 0, t], cloth_of[axis, 1, t], cloth_of[axis, 2, t]
                cloth[2 + axis, i] = _extent(crosses, corners, (w0, w1, w2), total, side)
        nx = w0 * nx_of[p] + w1 * nx_of[q] + w2 * nx_of[r]
        ny = w0 * ny_of[p] + w1 * ny_of[q] + w2 * ny_of[r]
        nz = w0 * nz_of[p] + w1 * nz_of[q] + w2 * nz_of[r]
        weight, shine = _shade((dx * depth, dy * depth, depth), (nx, ny, nz), (lx, ly, lz), material)
        out[0, i], out[1, i] = weight * area[i], shine * area[i]


@loop
def _extent(crosses, corners, weights, total, side):
    """How far a fragment reaches along one axis of the cloth: a square of `side` on the plane at depth 1.

    The coordinate there is sum(corner * w) / sum(w), each w linear in the ray: its two derivatives by the quotient
    rule. Never more than the whole triangle.
    """
    low, high = min(corners), max(corners)
    if total == 0:
        return 0.0
    here = weights[0] * corners[0] + weights[1] * corners[1] + weights[2] * corners[2]
    reach = 0.0
    for k in range(2):
        along = crosses[0][k] * corners[0] + crosses[1][k] * corners[1] + crosses[2][k] * corners[2]
        whole = crosses[0][k] + crosses[1][k] + crosses[2][k]
        reach += abs((along - here * whole) / total)
    return min(reach * side, high - low)


@loop
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@loop
def _weights(crosses, dx, dy):
    """d . (b x c) and so on: proportional to the perspective-correct weights of the corners where the ray d meets."""
    n0, n1, n2 = crosses
    return dx * n0[0] + dy * n0[1] + n0[2], dx * n1[0] + dy * n1[1] + n1[2], dx * n2[0] + dy * n2[1] + n2[2]


@loop
def _shade(point, normal, light, material):
    """Compute weight and highlight as `torch/matrix.py`; no highlight where its power is below `UNSEEN`."""
    ambient, diffuse, specular, shininess, least = material
    toward = (light[0] - point[0], light[1] - point[1], light[2] - point[2])
    to_normal, to_light, to_eye = 1 / _length(normal), 1 / _length(toward), 1 / _length(point)
    cosine = _dot(normal, toward) * to_normal * to_light
    if cosine <= 0:
        return ambient, 0.0
    # v.r with r = 2 (n.l) n - l, for the negated v.
    along = _dot(toward, point) * to_light * to_eye - 2 * cosine * (_dot(normal, point) * to_normal * to_eye)
    return ambient + diffuse * cosine, specular * max(along, 0.0) ** shininess if along > least else 0.0


@loop
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@loop
def _length(a):
    return max(np.sqrt(_dot(a, a)), _TINY)


@loop
def _texture_coordinates(uv_of, t, b1, b2, inset):
    """Compute texture coordinates as `texture.texture_coordinates`."""
    w0, w1, w2 = max(1 - b1 - b2, inset), max(b1, inset), max(b2, inset)
    whole = w0 + w1 + w2
    u = uv_of[0, 0, t] * w0 + uv_of[0, 1, t] * w1 + uv_of[0, 2, t] * w2
    v = uv_of[1, 0, t] * w0 + uv_of[1, 1, t] * w1 + uv_of[1, 2, t] * w2
    return u / whole, v / whole


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
