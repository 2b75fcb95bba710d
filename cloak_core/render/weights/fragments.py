"""From visible samples to lit fragments: what each triangle contributes to each pixel of a view.

A fragment is what is seen of one triangle within one pixel: its share of the pixel, and a point where it is lit. Here
it is made of the triangle's visible samples, lit at their mean position (with one sample per pixel, the sample itself);
area.py makes it from exact areas.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float32, Float64, Int64
from torch import Tensor

from cloak_core.render.compiled import arrays, use_loops
from cloak_core.render.visibility.keys import EMPTY, ID_BITS, triangle_ids
from cloak_core.render.visibility.projection import Screen
from cloak_core.render.visibility.rasterizer import Visibility
from cloak_core.render.weights import fragments_loops
from cloak_core.render.weights.shading import Light, shade
from cloak_core.render.weights.texture import texture_coordinates


@dataclass(frozen=True)
class Fragments:
    """N fragments of B views, sorted by view and pixel."""

    view: Int64[Tensor, " N"]
    pixel: Int64[Tensor, " N"]
    """Flat, y * W + x."""
    triangle: Int64[Tensor, " N"]
    area: Float32[Tensor, " N"]
    """Share of the pixel, in (0, 1]."""
    x: Float64[Tensor, " N"]
    y: Float64[Tensor, " N"]
    """Where they are lit, pixels from the top left corner of the image."""


def merge_samples(visibility: Visibility) -> Fragments:
    """The visible samples of every (pixel, triangle), merged."""
    keys, n, w = visibility.keys, visibility.grid, visibility.window
    if use_loops(keys.device):
        return _merge_by_loops(visibility)
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
        return Fragments(view, pixel, triangle, area, x, y)
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
    return Fragments(view, place - view * total, triangle, area, mean(x), mean(y))


def _merge_by_loops(visibility: Visibility) -> Fragments:
    n, w = visibility.grid, visibility.window
    found = fragments_loops.merge(*arrays(visibility.keys), n, w.y0 * n, w.x0 * n, visibility.width)
    view, pixel, triangle, area, x, y = map(torch.from_numpy, found)
    return Fragments(view, pixel, triangle, area, x, y)


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
    corner = triangles.index_select(1, fragments.triangle)
    if len(screen.x) > 1:
        corner = corner + fragments.view * screen.x.shape[1]
    position, (w1, w2) = _met(fragments, screen, corner)
    at = [[n.reshape(-1).index_select(0, corner[i]) for n in normals] for i in range(3)]
    w0 = 1 - w1 - w2
    normal = torch.stack([n0 * w0 + n1 * w1 + n2 * w2 for n0, n1, n2 in zip(*at, strict=True)])
    lights = light_positions
    if lights.shape[1] > 1:
        lights = torch.stack([t.index_select(0, fragments.view) for t in lights])
    weight, highlight = shade(position, normal, lights, light)
    uv = None if corner_uv is None else texture_coordinates(corner_uv.index_select(2, fragments.triangle), w1, w2)
    return weight * fragments.area, highlight * fragments.area, uv


def _met(
    fragments: Fragments, screen: Screen, corner: Int64[Tensor, "3 N"]
) -> tuple[Float32[Tensor, "3 N"], tuple[Float32[Tensor, " N"], Float32[Tensor, " N"]]]:
    """Where the rays through fragments' points meet their triangles, in view space, and the weights of corners 1 and 2.

    Works on unsnapped view space, so that it holds for triangles that reach behind the camera, too.
    """
    a, b, c = ([axis.reshape(-1).index_select(0, corner[i]) for axis in screen.view] for i in range(3))
    focal = screen.focal.view(-1)
    focal = focal.index_select(0, fragments.view) if len(focal) > 1 else focal
    dx = (fragments.x - screen.width / 2) / focal
    dy = (screen.height / 2 - fragments.y) / focal
    # d . (b x c) and so on, proportional to the perspective-correct weights of the corners.
    weights = [dx * n[0] + dy * n[1] + n[2] for n in (_cross(b, c), _cross(c, a), _cross(a, b))]
    total = weights[0] + weights[1] + weights[2]
    # A triangle seen exactly edge-on has no such point; its first corner stands in.
    w1, w2 = (weight / total.masked_fill(total == 0, torch.inf) for weight in weights[1:])
    depth = a[2] + (b[2] - a[2]) * w1 + (c[2] - a[2]) * w2
    return torch.stack([dx * depth, dy * depth, depth]).float(), (w1.float(), w2.float())


def _cross(a: list[Tensor], b: list[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
