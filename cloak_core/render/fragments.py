"""From visible samples to lit fragments: what each triangle contributes to each pixel of a view.

A fragment is a triangle's visible samples within one pixel, merged: their share of the pixel, and their mean position,
where it is shaded. With one sample per pixel that is the sample itself.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float32, Float64, Int64
from torch import Tensor

from cloak_core.render.projection import Screen
from cloak_core.render.rasterizer import EMPTY, ID_BITS, Visibility, triangle_ids
from cloak_core.render.shading import Light, shade


@dataclass(frozen=True)
class Fragments:
    """N fragments of B views, sorted by view, pixel and triangle."""

    view: Int64[Tensor, " N"]
    pixel: Int64[Tensor, " N"]
    """Flat, y * W + x."""
    triangle: Int64[Tensor, " N"]
    area: Float32[Tensor, " N"]
    """Share of the pixel, in (0, 1]."""
    x: Float64[Tensor, " N"]
    y: Float64[Tensor, " N"]
    """Mean position on the screen, pixels from the top left corner of the image."""

    @staticmethod
    def join(parts: list[Fragments]) -> Fragments:
        """Fragments of bands of one view, from top to bottom, as one."""
        return Fragments(*(torch.cat([getattr(part, f.name) for part in parts]) for f in fields(Fragments)))


def merge_samples(visibility: Visibility) -> Fragments:
    """The visible samples of every (pixel, triangle), merged."""
    keys, n, w = visibility.keys, visibility.grid, visibility.window
    rows, columns = keys.shape[1:]
    index = (keys.view(-1) != EMPTY).nonzero().view(-1)
    triangle = triangle_ids(keys.view(-1).index_select(0, index))
    row = torch.div(index, max(columns, 1), rounding_mode="floor")
    column = index - row * columns
    view = torch.div(row, max(rows, 1), rounding_mode="floor")
    row = row - view * rows + w.y0 * n
    column = column + w.x0 * n
    x, y = (column + 0.5).to(torch.float64) / n, (row + 0.5).to(torch.float64) / n
    if n == 1:
        return Fragments(view, row * visibility.width + column, triangle, torch.ones_like(x, dtype=torch.float32), x, y)
    shift = n.bit_length() - 1
    pixel = (row >> shift) * visibility.width + (column >> shift)
    total = visibility.width * visibility.height
    order = ((view * total + pixel) << ID_BITS) | triangle
    order, entry, count = torch.unique(order, return_inverse=True, return_counts=True)
    mean = lambda t: torch.zeros_like(order, dtype=torch.float64).index_add_(0, entry, t) / count
    place = order >> ID_BITS
    view = torch.div(place, total, rounding_mode="floor")
    area = (count.to(torch.float32)) / (n * n)
    return Fragments(view, place - view * total, order & ((1 << ID_BITS) - 1), area, mean(x), mean(y))


def light_fragments(
    fragments: Fragments,
    screen: Screen,
    triangles: Int64[Tensor, "3 T"],
    normals: Float32[Tensor, "3 B V"],
    light_positions: Float32[Tensor, "3 B"],
    light: Light,
) -> tuple[Float32[Tensor, " N"], Float32[Tensor, " N"]]:
    """Weight of the face's colour and highlight of every fragment, each times its share of the pixel.

    normals and light positions are in each view's own space.
    """
    corner = triangles.index_select(1, fragments.triangle) + fragments.view * screen.x.shape[1]
    points, bary = intersect(fragments, screen, corner)
    b1, b2 = (b.to(torch.float32) for b in bary)
    b0 = 1 - b1 - b2
    at = lambda table, c: table.reshape(-1).index_select(0, corner[c])
    interpolated = torch.stack([at(n, 0) * b0 + at(n, 1) * b1 + at(n, 2) * b2 for n in normals])
    lights = light_positions.index_select(1, fragments.view) if light_positions.shape[1] > 1 else light_positions
    weight, highlight = shade(points.to(torch.float32), interpolated, lights, light)
    return weight * fragments.area, highlight * fragments.area


def intersect(
    fragments: Fragments, screen: Screen, corner: Int64[Tensor, "3 N"]
) -> tuple[Float64[Tensor, "3 N"], tuple[Float64[Tensor, " N"], Float64[Tensor, " N"]]]:
    """Where the ray through each fragment meets its triangle: the point in view space, and weights of corners 1 and 2.

    Works on unsnapped view space, so that it holds for triangles that reach behind the camera, too.
    """
    a, b, c = ([axis.reshape(-1).index_select(0, corner[i]) for axis in screen.view] for i in range(3))
    focal = screen.focal.view(-1)
    focal = focal.index_select(0, fragments.view) if len(focal) > 1 else focal
    dx = (fragments.x - screen.width / 2) / focal
    dy = (screen.height / 2 - fragments.y) / focal
    # d . (b x c) and so on, proportional to the perspective-correct weights of the corners.
    bc, ca, ab = _cross(b, c), _cross(c, a), _cross(a, b)
    along = lambda n: dx * n[0] + dy * n[1] + n[2]
    w0, w1, w2 = along(bc), along(ca), along(ab)
    total = w0 + w1 + w2
    # A fragment seen exactly edge-on has no point of its own; it is lit where its first corner lies.
    total = torch.where(total == 0, torch.inf, total)
    w1, w2 = w1 / total, w2 / total
    depth = a[2] + w1 * (b[2] - a[2]) + w2 * (c[2] - a[2])
    return torch.stack([dx * depth, dy * depth, depth]), (w1, w2)


def _cross(a: list[Tensor], b: list[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
