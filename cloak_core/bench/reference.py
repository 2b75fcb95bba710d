"""The reference that views are judged by: the torch renderer's exact areas, with the light integrated over them.

Areas come from the torch backend (held against exact fractions by `bench stability`), light from its float64 twin: the
formula of `render.torch.shading`, ray by ray in world space.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import vertex_normals
from cloak_core.core.view import View, Window
from cloak_core.core.visibility.clipping import flatten
from cloak_core.core.visibility.settings import Light
from cloak_core.core.visibility.torch.areas import Parts, visible_parts
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.view_cache import ViewCache

Reals = Float64[np.ndarray, " N"]


class TwinLight:
    """Light on one pose seen by one camera."""

    def __init__(self, bodies: Bodies, camera: Camera, light: Light, pose: int = 0) -> None:
        self._vertices, self._triangles = bodies.vertices[pose].astype(np.float64), bodies.triangles
        self._normals = vertex_normals(bodies, pose)
        self._camera, self._light = camera, light
        pivot = camera.pivot or (self._vertices.min(0) + self._vertices.max(0)) / 2
        self._right, self._up, self._back = (np.array(axis) for axis in camera.axes)
        self._eye = np.asarray(pivot) + camera.distance * self._back

    def __call__(self, triangle: Int64[np.ndarray, " N"], x: Reals, y: Reals) -> tuple[Reals, Reals]:
        """Compute surface weight and highlight where the rays through points of the image meet triangles.

        x, y: pixels from the image's top left corner. A point a little outside its triangle is lit as on its edge.
        """
        camera, light = self._camera, self._light
        across, upward = (x - camera.width / 2) / camera.focal, (camera.height / 2 - y) / camera.focal
        ray = across[:, None] * self._right + upward[:, None] * self._up - self._back
        corner = self._triangles[triangle].T
        a, b, c = self._vertices[corner]
        weights = _meet(self._eye, ray, a, b - a, c - a)[..., None]
        point = (weights * np.stack([a, b, c])).sum(0)
        normal = _unit((weights * self._normals[corner]).sum(0))
        toward, outward = _unit(np.array(light.position, np.float64) - point), _unit(self._eye - point)
        cosine = (normal * toward).sum(1)
        reflected = 2 * cosine[:, None] * normal - toward
        gloss = np.maximum((outward * reflected).sum(1), 0) ** light.shininess
        return light.ambient + light.diffuse * np.maximum(cosine, 0), light.specular * gloss * (cosine > 0)


def _meet(
    eye: np.ndarray, ray: np.ndarray, a: np.ndarray, ab: np.ndarray, ac: np.ndarray
) -> Float64[np.ndarray, "3 N"]:
    """Weights of the corners where rays meet triangles (Möller and Trumbore), each in [0, 1]."""
    p, start = np.cross(ray, ac), eye - a
    area = (ab * p).sum(1)
    area = np.where(area == 0, np.inf, area)  # seen edge-on: the first corner stands in
    v = (start * p).sum(1) / area
    w = (ray * np.cross(start, ab)).sum(1) / area
    weights = np.clip(np.stack([1 - v - w, v, w]), 0, 1)
    return weights / weights.sum(0)


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


EXACT = "exact areas by torch"


@dataclass(frozen=True, eq=False)
class Matrix:
    """A view as entries (pixel, face, weight), with the pixels' coverage and highlight; all on the CPU."""

    pixel: Int64[Tensor, " E"]
    face: Int64[Tensor, " E"]
    weight: Float[Tensor, " E"]
    coverage: Float[Tensor, " pixels"]
    specular: Float[Tensor, " pixels"]
    face_count: int

    def image(self, colors: Float[Tensor, "F 3"], background: Float[Tensor, "pixels 3"]) -> Float[Tensor, "pixels 3"]:
        """Composited and clamped, float64."""
        body = torch.zeros(len(self.coverage), 3, dtype=torch.float64)
        body.index_add_(0, self.pixel, self.weight.double().unsqueeze(1) * colors.double()[self.face])
        body += self.specular.double().unsqueeze(1)
        return (body + (1 - self.coverage.double()).unsqueeze(1) * background.double()).clamp(0, 1)

    def gradient(self, upstream: Float[Tensor, "pixels 3"]) -> Float[Tensor, "F 3"]:
        """Differentiate sum(upstream * image before clamping) by the face colours, float64."""
        result = torch.zeros(self.face_count, 3, dtype=torch.float64)
        return result.index_add_(0, self.face, self.weight.double().unsqueeze(1) * upstream.double()[self.pixel])

    def without(self, pixels: Int64[Tensor, " C"]) -> Matrix:
        """The same view with nothing to see in these pixels."""
        kept = ~torch.isin(self.pixel, pixels)
        coverage, specular = (values.index_fill(0, pixels, 0) for values in (self.coverage, self.specular))
        return Matrix(self.pixel[kept], self.face[kept], self.weight[kept], coverage, specular, self.face_count)


def matrix_of(view: View, face_count: int) -> Matrix:
    """Make the matrix of a view."""
    view = replace(view, **{k: v.cpu() for k, v in vars(view).items() if isinstance(v, Tensor)})
    pixels = view.height * view.width
    row = torch.repeat_interleave(view.crow.diff(), output_size=len(view.face))
    coverage, specular = (torch.zeros(pixels).index_copy_(0, view.pixels, t) for t in (view.coverage, view.specular))
    return Matrix(view.pixels[row], view.face, view.weight, coverage, specular, face_count)


@dataclass(frozen=True, eq=False)
class Reference:
    """A view as it should be."""

    matrix: Matrix
    areas: Matrix
    """Without light: weights are shares of pixels, and there is no highlight."""
    visible: Float64[Tensor, " F"]
    """Pixels of each face that are visible."""
    crowded: Int64[Tensor, " C"]
    """Pixels of too many pieces to be exact: they are empty here, and nothing is compared in them."""
    how: str
    """`EXACT`, and how many crowded pixels it leaves out if any."""


def reference(bodies: Bodies, camera: Camera, light: Light, pose: int = 0) -> Reference:
    """Integrate coverage and light over what is visible of one view. Takes seconds to minutes."""
    cache, key, twin = ViewCache(bodies), [(pose, camera)], TwinLight(bodies, camera, light, pose)
    screen = cache.screen(key)
    flat = flatten(screen, torch.from_numpy(bodies.triangles.T.astype(np.int64)), 0, cache.cull(key, screen))
    found, crowded = [], [torch.zeros(0, dtype=torch.int64)]
    for parts in visible_parts(flat, Window(0, 0, camera.width, camera.height), camera.width):
        triangle = parts.triangles.ids[parts.pieces.owner]
        found.append((parts.pieces.place, triangle, _integrate(parts, triangle, twin, camera.width)))
        crowded.append(parts.pieces.place[parts.crowded].unique())
    nothing = torch.zeros(0, dtype=torch.int64)
    pixel, triangle, sums = (
        torch.cat(column, -1) for column in zip((nothing, nothing, torch.zeros(3, 0).double()), *found, strict=True)
    )
    some = (sums[0] > 0).nonzero().view(-1)
    pixel, triangle, (area, weight, highlight) = pixel[some], triangle[some], sums[:, some]
    face = torch.from_numpy(bodies.triangle_face.astype(np.int64))[triangle]
    coverage, specular = (_sums(pixel, t, camera.height * camera.width) for t in (area, highlight))
    matrix = Matrix(pixel, face, weight, coverage, specular, bodies.face_count)
    areas = replace(matrix, weight=area, specular=torch.zeros_like(coverage))
    left_out = torch.cat(crowded)
    how = EXACT + (f", without {len(left_out)} crowded pixels" if len(left_out) else "")
    return Reference(matrix, areas, _sums(face, area, bodies.face_count), left_out, how)


def _integrate(parts: Parts, triangle: Int64[Tensor, " P"], twin: TwinLight, width: int) -> Float64[Tensor, "3 P"]:
    """Integrate area, weight and highlight of every piece, with three points for each triangle of its parts' fans.

    The points integrate quadratic functions exactly.
    """
    sums, shape = torch.zeros(3, len(triangle), dtype=torch.float64), parts.shape
    for k in range(1, len(shape) - 1):
        corners = torch.stack([shape[0], shape[k], shape[k + 1]])
        (ax, ay), (bx, by), (cx, cy) = corners
        area = ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)).abs() / 2
        some = (area > 0).nonzero().view(-1)
        owner, area, middle = parts.owner[some], area[some], corners.mean(0) / 2
        place = parts.pieces.place[owner]
        for corner in corners:
            x, y = (corner / 2 + middle)[:, some]
            y = y + torch.div(place, width, rounding_mode="floor")
            values = twin(triangle[owner].numpy(), (x + place % width).numpy(), y.numpy())
            for total, value in zip(sums, (1.0, *map(torch.from_numpy, values)), strict=True):
                total.index_add_(0, owner, value * area / 3)
    return sums


def _sums(index: Tensor, values: Tensor, count: int) -> Float64[Tensor, " count"]:
    return torch.zeros(count, dtype=torch.float64).index_add_(0, index, values.double())
