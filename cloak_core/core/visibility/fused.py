"""Two stages on CUDA as one Triton kernel each: the nearest triangle at each sample, and light at every fragment.

The plain twin of each is in `torch/`: `cover` of sampling.py, bit for bit, and `light_fragments` of matrix.py.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable

import torch
import triton
import triton.language as tl
from jaxtyping import Float32, Int64
from torch import Tensor

from cloak_core.core.view import FlatTriangles, Fragments, Screen, Surface
from cloak_core.core.visibility.screen import DEPTH_BITS, ID_BITS

NO_FUSION = {"enable_fp_fusion": False}
"""Fused multiply-adds round once instead of twice: other bits than everywhere else."""
_SAMPLES = 64
"""Samples that a program tests at once."""
OPTIONS = {"num_warps": 1, **NO_FUSION}
_FRAGMENTS = 128
"""Fragments that a program lights at once."""


def kernel(*numbers: str) -> Callable[[Callable], object]:
    """Decorate a kernel, or a function of one; it is not compiled anew for other values of these numbers."""
    # Under pytest, functions come wrapped in a check of types, which cannot be compiled.
    return lambda function: triton.jit(inspect.unwrap(function), do_not_specialize=numbers)


@kernel()
def _one(out):
    tl.store(out, 1)


def try_out(device: torch.device) -> None:
    """Start a kernel on a device. Raises whatever Triton raises where it cannot."""
    _one[(1,)](torch.zeros(1, dtype=torch.int64, device=device), **NO_FUSION)


def cover(packed: Int64[Tensor, "rows columns"], flat: FlatTriangles, row0: int, column0: int, shift: int) -> None:
    """See `torch/sampling.py`."""
    columns = flat.x, flat.y, flat.inverse_depth, flat.corner, flat.ids, flat.one_sided
    if count := flat.corner.shape[1]:
        where = count, row0, column0, *packed.shape, shift
        draw[(count,)](packed, *(t.contiguous() for t in columns), *where, DEPTH_BITS, ID_BITS, _SAMPLES, **OPTIONS)


@kernel()
def _pick(a, b, c, number):
    return tl.where(number == 0, a, tl.where(number == 1, b, c))


@kernel("count", "row0", "column0", "rows", "columns", "shift")
def draw(
    packed, x, y, inverse_depth, corner, ids, one_sided, count, row0, column0, rows, columns, shift,
    DEPTH_BITS: tl.constexpr, ID_BITS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Draw one triangle for each program, at all samples of its bounding box, `BLOCK` at a time."""
    triangle = tl.program_id(0)
    a, b, c = (
        tl.load(corner + triangle),
        tl.load(corner + count + triangle),
        tl.load(corner + 2 * count + triangle),
    )
    ax, bx, cx = tl.load(x + a).to(tl.int64), tl.load(x + b).to(tl.int64), tl.load(x + c).to(tl.int64)
    ay, by, cy = tl.load(y + a).to(tl.int64), tl.load(y + b).to(tl.int64), tl.load(y + c).to(tl.int64)
    twice = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    dropped = (twice == 0) | ((twice > 0) & (tl.load(one_sided + triangle) != 0))

    # Canonical order (torch/sampling.py): the topmost corner, of two the right one, then clockwise.
    at_a, at_b, at_c = (ay << 32) - ax, (by << 32) - bx, (cy << 32) - cx
    first = tl.where((at_b < at_a) & (at_b <= at_c), 1, tl.where(at_c < at_a, 2, 0))
    step = tl.where(twice > 0, 1, 2)
    second, third = (first + step) % 3, (first + 2 * step) % 3
    x0, y0 = _pick(ax, bx, cx, first), _pick(ay, by, cy, first)
    x1, y1 = _pick(ax, bx, cx, second), _pick(ay, by, cy, second)
    x2, y2 = _pick(ax, bx, cx, third), _pick(ay, by, cy, third)
    n0 = tl.load(inverse_depth + _pick(a, b, c, first))
    n1 = tl.load(inverse_depth + _pick(a, b, c, second))
    n2 = tl.load(inverse_depth + _pick(a, b, c, third))
    d1x, d1y, d2x, d2y = x1 - x0, y1 - y0, x2 - x0, y2 - y0
    area = tl.maximum(d1x * d2y - d1y * d2x, 1)  # none of no area is drawn
    slope1, slope2 = (n1 - n0) / area.to(tl.float64), (n2 - n0) / area.to(tl.float64)

    # Samples of the bounding box.
    spacing = tl.full((), 1, tl.int64) << shift
    half = spacing // 2
    left = tl.maximum((tl.minimum(tl.minimum(x0, x1), x2) + half - 1) >> shift, column0)
    right = tl.minimum((tl.maximum(tl.maximum(x0, x1), x2) + half) >> shift, column0 + columns)
    top = tl.maximum((y0 + half - 1) >> shift, row0)
    bottom = tl.minimum((tl.maximum(y1, y2) + half) >> shift, row0 + rows)
    width = tl.maximum(right - left, 0)
    total = tl.where(dropped, 0, width * tl.maximum(bottom - top, 0))
    name = tl.load(ids + triangle)
    left_edge = (y1 > y2).to(tl.int64)
    start = total * 0
    while start < total:
        number = start + tl.arange(0, BLOCK)
        row, column = top + number // width, left + number % width
        across, down = column * spacing + half - x0, row * spacing + half - y0
        e1, e2 = d2y * across - d2x * down, d1x * down - d1y * across
        e0 = area - e1 - e2
        inside = (number < total) & (e1 >= 0) & (e2 > 0) & (e0 + left_edge > 0)
        depth = (e1.to(tl.float64) * slope1 + e2.to(tl.float64) * slope2) + n0
        most: tl.constexpr = (1 << DEPTH_BITS) - 1
        steps = tl.minimum(tl.maximum((depth * (1 << DEPTH_BITS)).to(tl.int64), 0), most)
        place = packed + (row - row0) * columns + (column - column0)
        tl.atomic_min(place, ((most - steps) << ID_BITS) | name, mask=inside, sem="relaxed")
        start += BLOCK


def light_fragments(
    fragments: Fragments, screen: Screen, surface: Surface, normals: Tensor, light_position: Tensor
) -> tuple[Float32[Tensor, " N"], Float32[Tensor, " N"], None, None]:
    """Light every fragment of bodies without textures and cloths, as `torch.matrix.light_fragments`."""
    count = len(fragments.triangle)
    out = torch.empty(2, count, dtype=torch.float32, device=normals.device)
    if count:
        columns = fragments.triangle, fragments.area, fragments.x, fragments.y
        space = screen.view[0], normals, light_position, screen.focal
        tensors = [t.contiguous() for t in (*columns, surface.triangles, *space)]
        light = surface.light
        material = [float(value) for value in (light.ambient, light.diffuse, light.specular, light.shininess)]
        sizes = count, surface.triangles.shape[1], normals.shape[1]
        grid = (triton.cdiv(count, _FRAGMENTS),)
        light_all[grid](out, *tensors, *sizes, screen.width / 2, screen.height / 2, *material, _FRAGMENTS, **NO_FUSION)
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
