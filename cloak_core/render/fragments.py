"""From visible samples to lit fragments: what each triangle contributes to each pixel of a view.

A fragment is what is seen of one triangle within one pixel: its share of the pixel, and a point where it is lit. Here
it is made of the triangle's visible samples, lit at their mean position (with one sample per pixel, the sample itself);
area.py makes it from exact areas.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields

import torch
from jaxtyping import Float32, Float64, Int64
from torch import Tensor

from cloak_core.render.projection import Screen
from cloak_core.render.rasterizer import EMPTY, ID_BITS, Visibility, triangle_ids
from cloak_core.render.shading import Light, shade
from cloak_core.render.texture import texture_coordinates


@dataclass(frozen=True)
class Points:
    """Q points of triangles as seen on the screen, where light is worked out."""

    view: Int64[Tensor, " Q"]
    triangle: Int64[Tensor, " Q"]
    x: Float64[Tensor, " Q"]
    y: Float64[Tensor, " Q"]
    """Pixels from the top left corner of the image."""


@dataclass(frozen=True)
class Fragments:
    """N fragments of B views, sorted by view and pixel."""

    view: Int64[Tensor, " N"]
    pixel: Int64[Tensor, " N"]
    """Flat, y * W + x."""
    triangle: Int64[Tensor, " N"]
    area: Float32[Tensor, " N"]
    """Share of the pixel, in (0, 1]."""
    points: Points
    point: Int64[Tensor, " N"] | None
    """Where each fragment is lit; None: at its own point."""

    @staticmethod
    def join(parts: list[Fragments]) -> Fragments:
        """Fragments of bands of one view, from top to bottom, as one."""
        cat = lambda items, names: [torch.cat([getattr(item, name) for item in items]) for name in names]
        starts = itertools.accumulate([len(part.points.view) for part in parts], initial=0)
        own = lambda part: torch.arange(len(part.view), device=part.view.device) if part.point is None else part.point
        point = torch.cat([own(part) + start for part, start in zip(parts, starts, strict=False)])
        points = Points(*cat([part.points for part in parts], [f.name for f in fields(Points)]))
        return Fragments(*cat(parts, ("view", "pixel", "triangle", "area")), points, point)


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
        area = torch.ones_like(x, dtype=torch.float32)
        pixel = row * visibility.width + column
        return Fragments(view, pixel, triangle, area, Points(view, triangle, x, y), None)
    shift = n.bit_length() - 1
    pixel = (row >> shift) * visibility.width + (column >> shift)
    total = visibility.width * visibility.height
    order = ((view * total + pixel) << ID_BITS) | triangle
    order, entry, count = torch.unique(order, return_inverse=True, return_counts=True)
    mean = lambda t: torch.zeros_like(order, dtype=torch.float64).index_add_(0, entry, t) / count
    place = order >> ID_BITS
    view = torch.div(place, total, rounding_mode="floor")
    area = (count.to(torch.float32)) / (n * n)
    triangle = order & ((1 << ID_BITS) - 1)
    return Fragments(view, place - view * total, triangle, area, Points(view, triangle, mean(x), mean(y)), None)


def light_fragments(
    fragments: Fragments,
    screen: Screen,
    triangles: Int64[Tensor, "3 T"],
    normals: Float32[Tensor, "3 B V"],
    light_positions: Float32[Tensor, "3 B"],
    light: Light,
    corner_uv: Float32[Tensor, "2 3 T"] | None = None,
) -> tuple[Float32[Tensor, " N"], Float32[Tensor, " N"], Float32[Tensor, "2 N"] | None]:
    """Weight of the face's colour and highlight of every fragment, each times its share of the pixel; and where
    triangles have texture coordinates, those of the point where each fragment is lit.

    normals and light positions are in each view's own space.
    """
    points = fragments.points
    corner = triangles.index_select(1, points.triangle)
    if len(screen.x) > 1:
        corner = corner + points.view * screen.x.shape[1]
    position, bary = intersect(points, screen, corner)
    b1, b2 = (b.to(torch.float32) for b in bary)
    b0 = 1 - b1 - b2
    at = lambda table, c: table.reshape(-1).index_select(0, corner[c])
    interpolated = torch.stack([at(n, 0) * b0 + at(n, 1) * b1 + at(n, 2) * b2 for n in normals])
    lights = light_positions.index_select(1, points.view) if light_positions.shape[1] > 1 else light_positions
    weight, highlight = shade(position.to(torch.float32), interpolated, lights, light)
    uv = None if corner_uv is None else texture_coordinates(corner_uv.index_select(2, points.triangle), b1, b2)
    if fragments.point is not None:
        weight, highlight = (t.index_select(0, fragments.point) for t in (weight, highlight))
        uv = None if uv is None else uv.index_select(1, fragments.point)
    return weight * fragments.area, highlight * fragments.area, uv


def intersect(
    points: Points, screen: Screen, corner: Int64[Tensor, "3 Q"]
) -> tuple[Float64[Tensor, "3 Q"], tuple[Float64[Tensor, " Q"], Float64[Tensor, " Q"]]]:
    """Where the ray through each point meets its triangle, in view space, and the weights of corners 1 and 2.

    Works on unsnapped view space, so that it holds for triangles that reach behind the camera, too.
    """
    a, b, c = ([axis.reshape(-1).index_select(0, corner[i]) for axis in screen.view] for i in range(3))
    focal = screen.focal.view(-1)
    focal = focal.index_select(0, points.view) if len(focal) > 1 else focal
    dx = (points.x - screen.width / 2) / focal
    dy = (screen.height / 2 - points.y) / focal
    # d . (b x c) and so on, proportional to the perspective-correct weights of the corners.
    bc, ca, ab = _cross(b, c), _cross(c, a), _cross(a, b)
    along = lambda n: dx * n[0] + dy * n[1] + n[2]
    w0, w1, w2 = along(bc), along(ca), along(ab)
    total = w0 + w1 + w2
    # A triangle seen exactly edge-on has no such point; its first corner stands in.
    total = torch.where(total == 0, torch.inf, total)
    w1, w2 = w1 / total, w2 / total
    depth = a[2] + w1 * (b[2] - a[2]) + w2 * (c[2] - a[2])
    return torch.stack([dx * depth, dy * depth, depth]), (w1, w2)


def _cross(a: list[Tensor], b: list[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
