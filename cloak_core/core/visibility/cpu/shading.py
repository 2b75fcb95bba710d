"""Light at every fragment, as numba loops in float64 (torch/shading.py gives the formula)."""

from __future__ import annotations

import numpy as np

from cloak_core.core.visibility.compiled import loop
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
def light_all(triangle, area, x, y, corner, space, camera, normals, light, material, uv_of, out):
    """Light each fragment: weight, highlight and any texture coordinates into the rows of `out` [2 or 4, N].

    x, y: where each fragment is lit, pixels; space: view space coordinates [3, V]; camera: focal length and the
    image's middle, pixels; normals [3, V] and light [3]: in view space; material: see `material_of`; uv_of: texture
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
    """Compute weight and highlight as `torch/shading.py`; no highlight where its power is below `UNSEEN`."""
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
    """Compute texture coordinates as `texture.texture_coordinates`."""
    w0, w1, w2 = max(1 - b1 - b2, INSET), max(b1, INSET), max(b2, INSET)
    whole = w0 + w1 + w2
    u = uv_of[0, 0, t] * w0 + uv_of[0, 1, t] * w1 + uv_of[0, 2, t] * w2
    v = uv_of[1, 0, t] * w0 + uv_of[1, 1, t] * w1 + uv_of[1, 2, t] * w2
    return u / whole, v / whole
