"""From samples to lit fragments to views' matrices, as loops for the CPU.

The torch operations in fragments.py, shading.py and assembly.py say what is done and why; here all of it is in float64.
"""

from __future__ import annotations

import numpy as np

from cloak_core.render.compiled import loop
from cloak_core.render.covering import ID_BITS
from cloak_core.render.covering_loops import EMPTY
from cloak_core.render.shading import Light
from cloak_core.render.texture import INSET

_ID = (1 << ID_BITS) - 1
_TINY = 1e-20
UNSEEN = 1e-12
"""Share of a highlight that is left out: powers take time."""


def material(light: Light) -> tuple[float, ...]:
    """Ambient, diffuse, specular, shininess; and the least cosine whose power is not below `UNSEEN`."""
    least = UNSEEN ** (1 / light.shininess) if light.shininess > 0 else -np.inf
    return float(light.ambient), float(light.diffuse), float(light.specular), float(light.shininess), float(least)


@loop
def most_fragments(keys, grid):
    """At least as many as `merge` finds: changes of triangle along the rows of samples within pixels."""
    views, rows, columns = keys.shape
    count = 0
    for view in range(views):
        for row in range(rows):
            line = keys[view, row]
            for left in range(0, columns, grid):
                count += line[left] != EMPTY
                for column in range(left + 1, left + grid):
                    count += (line[column] != EMPTY) & ((line[column - 1] ^ line[column]) & _ID != 0)
    return count


@loop
def merge(keys, grid, row0, column0, width, view_of, pixel, triangle, area, x, y):
    """Each pixel's visible samples by triangle, ascending, with their mean position; returns how many there are.

    keys: [B, rows, columns], grid x grid samples to a pixel, from the sample at row0 and column0 of the image on.
    """
    views, rows, columns = keys.shape
    names, sums, count = np.empty(grid * grid, np.int64), np.empty((3, grid * grid), np.int64), 0
    for view in range(views):
        for top in range(0, rows, grid):
            for left in range(0, columns, grid):
                found = _gather(keys[view], top, left, grid, names, sums)
                place = (row0 + top) // grid * width + (column0 + left) // grid
                for i in range(found):
                    held = sums[0, i]
                    x[count] = (column0 + left + 0.5 + sums[1, i] / held) / grid
                    y[count] = (row0 + top + 0.5 + sums[2, i] / held) / grid
                    area[count] = held / (grid * grid)
                    view_of[count], pixel[count], triangle[count] = view, place, names[i]
                    count += 1
    return count


@loop
def _gather(keys, top, left, grid, names, sums):
    """The triangles in a pixel, ascending, and of each one's samples the number and the sums of columns and rows."""
    found = 0
    for row in range(grid):
        for column in range(grid):
            key = keys[top + row, left + column]
            if key == EMPTY:
                continue
            at = found - 1  # the latest is the likeliest
            while at >= 0 and names[at] != key & _ID:
                at -= 1
            if at < 0:
                at = found
                while at > 0 and names[at - 1] > key & _ID:
                    names[at], sums[0, at] = names[at - 1], sums[0, at - 1]
                    sums[1, at], sums[2, at] = sums[1, at - 1], sums[2, at - 1]
                    at -= 1
                names[at] = key & _ID
                sums[0, at] = sums[1, at] = sums[2, at] = 0
                found += 1
            sums[0, at] += 1
            sums[1, at] += column
            sums[2, at] += row
    return found


@loop
def light(view_of, triangle, area, x, y, offset, corner, space, focal, middle, normals, lights, material, uv_of, out):
    """Weight, highlight and, where there are textures, coordinates of each fragment into the rows of `out` [2 or 4, N].

    x, y: a point of each fragment's triangle, pixels; offset [2, N]: from there to where the fragment is lit, or
    [2, 0]. space: view space coordinates [3, B, V]; middle: of the image; normals [3, B, V]; lights [3, B]; material:
    see `material`; uv_of: texture coordinates [2, 3, T] or [2, 3, 0].
    """
    moved, textured = offset.shape[1] > 0, uv_of.shape[2] > 0
    for i in range(len(triangle)):
        b, t = view_of[i], triangle[i]
        p, q, r = corner[0, t], corner[1, t], corner[2, t]
        crosses = _crosses(space[:, b, p], space[:, b, q], space[:, b, r])
        step = 1 / focal[b]
        dx, dy = (x[i] - middle[0]) * step, (middle[1] - y[i]) * step
        w0, w1, w2 = _weights(crosses, dx, dy)
        total = w0 + w1 + w2
        if total == 0:  # seen exactly edge-on: its first corner stands in
            w0, w1, w2, near, depth = 1.0, 0.0, 0.0, 1.0, space[2, b, p]
        else:
            scale, near = 1 / total, 1.0
            depth = (w0 * space[2, b, p] + w1 * space[2, b, q] + w2 * space[2, b, r]) * scale
            if moved:
                dx += offset[0, i] * step
                dy -= offset[1, i] * step
                w0, w1, w2 = _weights(crosses, dx, dy)
                # Behind the camera the plane has no depth; only slivers' planes reach there, between their own pixels.
                near = max((w0 + w1 + w2) * scale, 1e-6)
                depth /= near
            w0, w1, w2 = w0 * scale, w1 * scale, w2 * scale
        if textured:
            out[2, i], out[3, i] = _texture_coordinates(uv_of, t, w1 / near, w2 / near)
        nx = w0 * normals[0, b, p] + w1 * normals[0, b, q] + w2 * normals[0, b, r]
        ny = w0 * normals[1, b, p] + w1 * normals[1, b, q] + w2 * normals[1, b, r]
        nz = w0 * normals[2, b, p] + w1 * normals[2, b, q] + w2 * normals[2, b, r]
        weight, shine = _shade((dx * depth, dy * depth, depth), (nx, ny, nz), lights[:, b], material)
        out[0, i], out[1, i] = weight * area[i], shine * area[i]


@loop
def _crosses(a, b, c):
    """b x c, c x a, a x b."""
    return _cross(b, c), _cross(c, a), _cross(a, b)


@loop
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@loop
def _weights(crosses, dx, dy):
    """d . (b x c) and so on: proportional to the perspective-correct weights of the corners where the ray d meets."""
    n0, n1, n2 = crosses
    return dx * n0[0] + dy * n0[1] + n0[2], dx * n1[0] + dy * n1[1] + n1[2], dx * n2[0] + dy * n2[1] + n2[2]


@loop
def _shade(point, normal, lights, material):
    """Weight and highlight, as `shading.shade`; where the highlight's power is below `UNSEEN` there is none."""
    ambient, diffuse, specular, shininess, least = material
    toward = (lights[0] - point[0], lights[1] - point[1], lights[2] - point[2])
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
def fold(place, area, highlight, face, weight, uv, by_face, places, coverage, specular, crow, column, value, out_uv):
    """Fragments to the rows of a matrix, one for each place (ascending); returns how many rows and entries there are.

    by_face: within a place, one entry for each face, ascending; else one for each fragment, as they come.
    """
    rows = entries = begin = 0
    for i in range(len(place)):
        if i == 0 or place[i] != place[i - 1]:
            places[rows] = place[i]
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
        if uv.shape[1]:
            out_uv[0, at], out_uv[1, at] = uv[0, i], uv[1, i]
        entries += 1
    crow[rows] = entries
    return rows, entries
