"""Light at every fragment as one Triton kernel; `torch/shading.py` gives the formula and is its plain twin."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from jaxtyping import Float32
from torch import Tensor

from cloak_core.core.view import Fragments, Screen, Surface
from cloak_core.core.visibility.fused.kernel import NO_FUSION, kernel

BLOCK = 128


def light_fragments(
    fragments: Fragments, screen: Screen, surface: Surface, normals: Tensor, light_position: Tensor
) -> tuple[Float32[Tensor, " N"], Float32[Tensor, " N"], None, None]:
    """Light every fragment of bodies without textures and cloths, as `torch.shading.light_fragments`."""
    count = len(fragments.triangle)
    out = torch.empty(2, count, dtype=torch.float32, device=normals.device)
    if count:
        columns = fragments.triangle, fragments.area, fragments.x, fragments.y
        space = screen.view[0], normals, light_position, screen.focal
        tensors = [t.contiguous() for t in (*columns, surface.triangles, *space)]
        light = surface.light
        material = [float(value) for value in (light.ambient, light.diffuse, light.specular, light.shininess)]
        sizes = count, surface.triangles.shape[1], normals.shape[1]
        grid = (triton.cdiv(count, BLOCK),)
        light_all[grid](out, *tensors, *sizes, screen.width / 2, screen.height / 2, *material, BLOCK, **NO_FUSION)
    return out[0], out[1], None, None


@kernel()
def _vector(values, stride, number):
    return (
        tl.load(values + number).to(tl.float64),
        tl.load(values + stride + number).to(tl.float64),
        tl.load(values + 2 * stride + number).to(tl.float64),
    )


@kernel()
def _dot(ax, ay, az, bx, by, bz):
    return ax * bx + ay * by + az * bz


@kernel()
def _weight(dx, dy, ax, ay, az, bx, by, bz):
    """Compute d . (a x b) of the ray d = (dx, dy, 1)."""
    return dx * (ay * bz - az * by) + dy * (az * bx - ax * bz) + (ax * by - ay * bx)


@kernel()
def _length(x, y, z):
    return tl.maximum(tl.sqrt(_dot(x, y, z, x, y, z)), 1e-20)


@kernel("count", "triangles", "vertices")
def light_all(
    out, triangle, area, x, y, corner, space, normals, light, focal, count, triangles, vertices, middle_x, middle_y,
    ambient, diffuse, specular, shininess, BLOCK: tl.constexpr,
):  # fmt: skip
    """Light `BLOCK` fragments for each program: weight and highlight into `out` [2, N]."""
    number = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    some = number < count
    own = tl.load(triangle + number, mask=some, other=0)
    share = tl.load(area + number, mask=some, other=0.0).to(tl.float64)
    p, q, r = tl.load(corner + own), tl.load(corner + triangles + own), tl.load(corner + 2 * triangles + own)
    ax, ay, az = _vector(space, vertices, p)
    bx, by, bz = _vector(space, vertices, q)
    cx, cy, cz = _vector(space, vertices, r)

    # Where the ray through the fragment's point meets its triangle, by weights of the corners.
    scale = tl.load(focal)
    dx = (tl.load(x + number, mask=some, other=0.0) - middle_x) / scale
    dy = (middle_y - tl.load(y + number, mask=some, other=0.0)) / scale
    w1, w2 = _weight(dx, dy, cx, cy, cz, ax, ay, az), _weight(dx, dy, ax, ay, az, bx, by, bz)
    total = _weight(dx, dy, bx, by, bz, cx, cy, cz) + w1 + w2
    edge_on = total == 0  # its first corner stands in
    whole = tl.where(edge_on, 1.0, total)
    w1, w2 = tl.where(edge_on, 0.0, w1 / whole), tl.where(edge_on, 0.0, w2 / whole)
    w0 = 1.0 - w1 - w2
    pz = w0 * az + w1 * bz + w2 * cz
    px, py = dx * pz, dy * pz

    # Phong shading.
    ax, ay, az = _vector(normals, vertices, p)
    bx, by, bz = _vector(normals, vertices, q)
    cx, cy, cz = _vector(normals, vertices, r)
    nx, ny, nz = w0 * ax + w1 * bx + w2 * cx, w0 * ay + w1 * by + w2 * cy, w0 * az + w1 * bz + w2 * cz
    lx, ly, lz = tl.load(light) - px, tl.load(light + 1) - py, tl.load(light + 2) - pz
    to_normal, to_light, to_eye = _length(nx, ny, nz), _length(lx, ly, lz), _length(px, py, pz)
    cosine = _dot(nx, ny, nz, lx, ly, lz) / (to_normal * to_light)
    back = _dot(nx, ny, nz, px, py, pz) / (to_normal * to_eye)
    reflected = _dot(lx, ly, lz, px, py, pz) / (to_light * to_eye) - 2 * cosine * back
    power = tl.exp(shininess * tl.log(tl.maximum(reflected, 1e-300)))
    weight = ambient + diffuse * tl.maximum(cosine, 0.0)
    highlight = tl.where(cosine > 0, specular * power, 0.0)
    tl.store(out + number, (weight * share).to(tl.float32), mask=some)
    tl.store(out + count + number, (highlight * share).to(tl.float32), mask=some)
