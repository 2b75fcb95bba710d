"""The nearest triangle at each sample as one Triton kernel; `torch/sampling.py` is its plain twin, bit for bit."""

from __future__ import annotations

import triton.language as tl
from jaxtyping import Int64
from torch import Tensor

from cloak_core.core.view import FlatTriangles
from cloak_core.core.visibility.fused.kernel import NO_FUSION, kernel
from cloak_core.core.visibility.packing import DEPTH_BITS, ID_BITS

BLOCK = 64
"""Samples that a program tests at once."""
OPTIONS = {"num_warps": 1, **NO_FUSION}


def cover(packed: Int64[Tensor, "rows columns"], flat: FlatTriangles, row0: int, column0: int, shift: int) -> None:
    """See `torch/sampling.py`."""
    columns = flat.x, flat.y, flat.inverse_depth, flat.corner, flat.ids, flat.one_sided
    if count := flat.corner.shape[1]:
        where = count, row0, column0, *packed.shape, shift
        draw[(count,)](packed, *(t.contiguous() for t in columns), *where, DEPTH_BITS, ID_BITS, BLOCK, **OPTIONS)


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
