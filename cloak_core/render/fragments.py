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

from cloak_core.render import fragments_loops
from cloak_core.render.compiled import arrays, use_loops
from cloak_core.render.projection import Screen
from cloak_core.render.rasterizer import Visibility
from cloak_core.render.shading import Light, shade
from cloak_core.render.texture import texture_coordinates
from cloak_core.render.visibility.keys import EMPTY, ID_BITS, triangle_ids


@dataclass(frozen=True)
class Points:
    """Q points of triangles as seen on the screen."""

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
    """Where fragments are lit; or, Q of them, a point of each triangle that is seen, which its fragments share."""
    point: Int64[Tensor, " N"] | None = None
    """Each fragment's point; None: they stand in the same order."""
    offset: Float32[Tensor, "2 N"] | None = None
    """From that point to where the fragment is lit, right and down, pixels; None: nothing."""


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
        return Fragments(view, pixel, triangle, area, Points(view, triangle, x, y))
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
    return Fragments(view, place - view * total, triangle, area, Points(view, triangle, mean(x), mean(y)))


def _merge_by_loops(visibility: Visibility) -> Fragments:
    n, w = visibility.grid, visibility.window
    found = fragments_loops.merge(*arrays(visibility.keys), n, w.y0 * n, w.x0 * n, visibility.width)
    view, pixel, triangle, area, x, y = map(torch.from_numpy, found)
    return Fragments(view, pixel, triangle, area, Points(view, triangle, x, y))


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
    facets = Facets.build(points, screen, corner, normals)
    lights = light_positions
    if lights.shape[1] > 1:
        lights = torch.stack([t.index_select(0, fragments.view) for t in lights])
    position, normal = facets.at_points() if fragments.point is None else facets.at(fragments.point, fragments.offset)
    weight, highlight = shade(position, normal, lights, light)
    uv = None
    if corner_uv is not None:
        weights = facets.weights if fragments.point is None else facets.weights_at(fragments.point, fragments.offset)
        uv = texture_coordinates(corner_uv.index_select(2, fragments.triangle), *weights)
    return weight * fragments.area, highlight * fragments.area, uv


@dataclass(frozen=True)
class Facets:
    """Q triangles about a point of each: what the ray through a pixel nearby meets there, in view space.

    Along the screen the weights of a triangle's corners are linear but for a common factor; so are the normal, whose
    length does not matter, and the inverse of depth. float32 is enough for differences to the point.
    """

    direction: Float32[Tensor, "2 Q"]
    """x and y of the ray through the point, for z = 1."""
    depth: Float32[Tensor, " Q"]
    normal: Float32[Tensor, "3 Q"]
    pixel: Float32[Tensor, " Q"]
    """What the ray's direction changes by from a pixel to the next, 1 / focal."""
    turn: tuple[Float32[Tensor, "3 Q"], Float32[Tensor, "3 Q"]]
    """Change of the normal for one unit of the ray's x, and of its y."""
    near: tuple[Float32[Tensor, " Q"], Float32[Tensor, " Q"]]
    """Change of depth at the point over depth, likewise."""
    weights: tuple[Float32[Tensor, " Q"], Float32[Tensor, " Q"]]
    """Of corners 1 and 2, at the point."""
    lean: tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]
    """Change of weights 1 and 2 times depth at the point over depth, for one unit of the ray's x, and of its y."""

    @staticmethod
    def build(
        points: Points, screen: Screen, corner: Int64[Tensor, "3 Q"], normals: Float32[Tensor, "3 B V"]
    ) -> Facets:
        """Works on unsnapped view space, so that it holds for triangles that reach behind the camera, too."""
        a, b, c = ([axis.reshape(-1).index_select(0, corner[i]) for axis in screen.view] for i in range(3))
        focal = screen.focal.view(-1)
        focal = focal.index_select(0, points.view) if len(focal) > 1 else focal.expand(len(points.view))
        dx = (points.x - screen.width / 2) / focal
        dy = (screen.height / 2 - points.y) / focal
        # d . (b x c) and so on, proportional to the perspective-correct weights of the corners.
        crosses = _cross(b, c), _cross(c, a), _cross(a, b)
        weights = [(dx * n[0]).add_(dy * n[1]).add_(n[2]) for n in crosses]
        total = weights[0] + weights[1] + weights[2]
        # A triangle seen exactly edge-on has no such point; its first corner stands in.
        scale = 1 / total.masked_fill_(total == 0, torch.inf)
        w1, w2 = (w.mul_(scale) for w in weights[1:])
        depth = (b[2] - a[2]).mul_(w1).add_((c[2] - a[2]).mul_(w2)).add_(a[2])
        w1, w2 = w1.float(), w2.float()
        at = [[n.reshape(-1).index_select(0, corner[i]) for n in normals] for i in range(3)]
        mix = lambda w0, w1, w2: torch.stack([n0 * w0 + n1 * w1 + n2 * w2 for n0, n1, n2 in zip(*at, strict=True)])
        turns, nears, lean = [], [], []
        for axis in range(2):
            change = [(n[axis] * scale).float() for n in crosses]
            turns.append(mix(*change))
            nears.append(change[0] + change[1] + change[2])
            lean.append((change[1], change[2]))
        direction = torch.stack([dx.float(), dy.float()])
        normal = mix(1 - w1 - w2, w1, w2)
        pixel = (1 / focal).float()
        return Facets(direction, depth.float(), normal, pixel, tuple(turns), tuple(nears), (w1, w2), tuple(lean))

    def at_points(self) -> tuple[Float32[Tensor, "3 Q"], Float32[Tensor, "3 Q"]]:
        """Position and normal (of any length) at the facets' own points."""
        return torch.stack([*(self.direction * self.depth), self.depth]), self.normal

    def at(
        self, index: Int64[Tensor, " N"], offset: Float32[Tensor, "2 N"]
    ) -> tuple[Float32[Tensor, "3 N"], Float32[Tensor, "3 N"]]:
        """The same of these facets at places `offset` pixels right of and below their points."""
        pick = lambda t: t.index_select(0, index)
        x, y, nearness = self._away(index, offset)
        normal = [pick(n) + pick(u) * x + pick(v) * y for n, u, v in zip(self.normal, *self.turn, strict=True)]
        depth = pick(self.depth) / nearness
        direction = [pick(d).add_(step).mul_(depth) for d, step in zip(self.direction, (x, y), strict=True)]
        return torch.stack([*direction, depth]), torch.stack(normal)

    def weights_at(self, index: Int64[Tensor, " N"], offset: Float32[Tensor, "2 N"]) -> list[Float32[Tensor, " N"]]:
        """Weights of corners 1 and 2 there."""
        pick = lambda t: t.index_select(0, index)
        x, y, nearness = self._away(index, offset)
        return [
            (pick(w) + pick(u) * x + pick(v) * y) / nearness for w, u, v in zip(self.weights, *self.lean, strict=True)
        ]

    def _away(self, index: Tensor, offset: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Change of the ray's direction, and depth at the point over depth there."""
        pick = lambda t: t.index_select(0, index)
        pixel = pick(self.pixel)
        x, y = offset[0] * pixel, -offset[1] * pixel
        # Behind the camera the plane has no depth; only slivers' planes reach there, between their own pixels.
        return x, y, (pick(self.near[0]) * x + pick(self.near[1]) * y).add_(1).clamp_(min=1e-6)


def _cross(a: list[Tensor], b: list[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
