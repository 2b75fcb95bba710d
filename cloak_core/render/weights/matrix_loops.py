"""Fragments to light to a view's matrix, as loops for the CPU, in float64.

The torch operations in matrix.py and shading.py say what is done and why.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.render.compiled import arrays, loop
from cloak_core.render.threads import spread
from cloak_core.render.visibility.projection import Screen
from cloak_core.render.weights.fragments import Fragments
from cloak_core.render.weights.matrix import Surface
from cloak_core.render.weights.shading import Light
from cloak_core.render.weights.texture import INSET
from cloak_core.render.weights.view import View

_TINY = 1e-20
UNSEEN = 1e-12
"""Share of a highlight that is left out: powers take time."""


def build_view(
    bands: Sequence[Fragments],
    screen: Screen,
    surface: Surface,
    normals: Float32[Tensor, "3 V"],
    light_position: Float32[Tensor, " 3"],
    count: int,
) -> View:
    """See matrix.py."""
    textured = surface.corner_uv is not None
    space = np.stack([axis[0].numpy() for axis in screen.view])
    camera = float(screen.focal), screen.width / 2, screen.height / 2
    corner, face_of, normal, position = arrays(surface.triangles, surface.face, normals, light_position)
    uv_of = arrays(surface.corner_uv)[0] if textured else np.empty((2, 3, 0), np.float32)
    about = corner, space, camera, normal, position, _material(surface.light), uv_of, face_of, surface.by_face

    def rows_of(found: Fragments) -> tuple:
        return _matrix(*arrays(found.pixel, found.triangle, found.area, found.x, found.y), *about)

    parts = spread(rows_of, bands, count)
    pixels, coverage, specular = (_join([rows[i] for rows, _ in parts]) for i in range(3))
    face, weight, uv = (_join([entries[i] for _, entries in parts]) for i in range(3))
    before = np.cumsum([0, *(rows[3][-1] for rows, _ in parts)])
    crow = _join([rows[3][i > 0 :] + before[i] for i, (rows, _) in enumerate(parts)])
    return View(screen.height, screen.width, pixels, coverage, specular, crow, face, weight, uv if textured else None)


def _join(parts: list[np.ndarray]) -> Tensor:
    return torch.from_numpy(parts[0] if len(parts) == 1 else np.concatenate(parts, -1))


def _material(light: Light) -> tuple[float, ...]:
    """Ambient, diffuse, specular, shininess; and the least cosine whose power is not below `UNSEEN`."""
    least = UNSEEN ** (1 / light.shininess) if light.shininess > 0 else -np.inf
    return float(light.ambient), float(light.diffuse), float(light.specular), float(light.shininess), float(least)


@loop
def _matrix(
    pixel, triangle, area, x, y, corner, space, camera, normals, light, material, uv_of, face_of, by_face
):  # fmt: skip
    """The rows of a view's matrix from its fragments, sorted by pixel: pixel, coverage and highlight of each row; row
    offsets, face, weight and texture coordinates of its entries. The arguments are those of `light_all` and `fold`."""
    out = np.empty((4 if uv_of.shape[2] else 2, len(triangle)), np.float32)
    light_all(triangle, area, x, y, corner, space, camera, normals, light, material, uv_of, out)
    return fold(pixel, area, out[1], face_of[triangle], out[0], out[2:], by_face)


@loop
def light_all(triangle, area, x, y, corner, space, camera, normals, light, material, uv_of, out):
    """Weight, highlight and, where there are textures, coordinates of each fragment into the rows of `out` [2 or 4, N].

    x, y: where each fragment is lit, pixels; space: view space coordinates [3, V]; camera: focal length and the
    image's middle, pixels; normals [3, V] and light [3]: in view space; material: see `_material`; uv_of: texture
    coordinates [2, 3, T] or [2, 3, 0].
    """
    focal, middle_x, middle_y = camera
    ax, ay, az = space[0], space[1], space[2]
    nx_of, ny_of, nz_of = normals[0], normals[1], normals[2]
    lx, ly, lz = light[0], light[1], light[2]
    step, textured = 1 / focal, uv_of.shape[2] > 0
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
            w0, w1, w2, depth = 1.0, 0.0, 0.0, az[p]
        else:
            scale = 1 / total
            w0, w1, w2 = w0 * scale, w1 * scale, w2 * scale
            depth = w0 * az[p] + w1 * az[q] + w2 * az[r]
        if textured:
            out[2, i], out[3, i] = _texture_coordinates(uv_of, t, w1, w2)
        nx = w0 * nx_of[p] + w1 * nx_of[q] + w2 * nx_of[r]
        ny = w0 * ny_of[p] + w1 * ny_of[q] + w2 * ny_of[r]
        nz = w0 * nz_of[p] + w1 * nz_of[q] + w2 * nz_of[r]
        weight, shine = _shade((dx * depth, dy * depth, depth), (nx, ny, nz), (lx, ly, lz), material)
        out[0, i], out[1, i] = weight * area[i], shine * area[i]


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
    """Weight and highlight, as `shading.shade`; where the highlight's power is below `UNSEEN` there is none."""
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
def _texture_coordinates(uv_of, t, b1, b2):
    """As `texture.texture_coordinates`."""
    w0, w1, w2 = max(1 - b1 - b2, INSET), max(b1, INSET), max(b2, INSET)
    whole = w0 + w1 + w2
    u = uv_of[0, 0, t] * w0 + uv_of[0, 1, t] * w1 + uv_of[0, 2, t] * w2
    v = uv_of[1, 0, t] * w0 + uv_of[1, 1, t] * w1 + uv_of[1, 2, t] * w2
    return u / whole, v / whole


@loop
def fold(pixel, area, highlight, face, weight, uv, by_face):
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
    of_rows = pixels[:rows].copy(), coverage[:rows].copy(), specular[:rows].copy(), crow[: rows + 1].copy()
    return of_rows, (column[:entries].copy(), value[:entries].copy(), uv)
