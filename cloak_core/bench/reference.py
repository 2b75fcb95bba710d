"""The reference that views are judged by: exact areas in pixels an eighth as wide, each part lit by itself.

Areas come from the loops (`bench stability` holds them against exact fractions), light from its float64 twin: the
formula of `torch.matrix`, ray by ray in world space.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import vertex_normals
from cloak_core.core.view import Fragments, View, Window
from cloak_core.core.visibility.cpu.areas import visible_areas
from cloak_core.core.visibility.projection import flatten
from cloak_core.core.visibility.screen import GUARD
from cloak_core.core.visibility.settings import Light
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.view_cache import ViewCache

Reals = Float64[np.ndarray, " N"]


class TwinLight:
    """Light on the first pose seen by one camera."""

    def __init__(self, bodies: Bodies, camera: Camera, light: Light) -> None:
        self._vertices = bodies.vertices[0].astype(np.float64)
        self._triangles = bodies.triangles
        self._normals = vertex_normals(bodies)
        self._camera = camera
        self._light = light
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
    p = np.cross(ray, ac)
    start = eye - a
    area = (ab * p).sum(1)
    area = np.where(area == 0, np.inf, area)  # seen edge-on: the first corner stands in
    v = (start * p).sum(1) / area
    w = (ray * np.cross(start, ab)).sum(1) / area
    weights = np.clip(np.stack([1 - v - w, v, w]), 0, 1)
    return weights / weights.sum(0)


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


EXACT = "exact areas in finer pixels"
FINER = (8, 4, 2, 1)
"""Finer pixels along a pixel's side. The light's error falls with their square: 64 times."""


@dataclass(frozen=True, eq=False)
class ReferenceMatrix:
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


def matrix_of(view: View, face_count: int) -> ReferenceMatrix:
    """Make the matrix of a view."""
    on_pixels = view.pixels.cpu()
    entries = view.map.to("cpu")
    pixels = view.height * view.width
    coverage, specular = (
        torch.zeros(pixels).index_copy_(0, on_pixels, t.cpu()) for t in (view.coverage, view.specular)
    )
    return ReferenceMatrix(on_pixels[entries.row], entries.column, entries.weight, coverage, specular, face_count)


@dataclass(frozen=True, eq=False)
class Reference:
    """A view as it should be."""

    matrix: ReferenceMatrix
    areas: ReferenceMatrix
    """Without light: weights are shares of pixels, and there is no highlight."""
    visible: Float64[Tensor, " F"]
    """Pixels of each face that are visible."""


def reference(bodies: Bodies, camera: Camera, light: Light) -> Reference:
    """Sum coverage and light over the visible parts of finer pixels of one view. Takes seconds to minutes."""
    cache = ViewCache(bodies)
    key = [(0, camera)]
    screen = cache.screen(key)
    flat = flatten(screen, torch.from_numpy(bodies.triangles.T.astype(np.int64)), 0, cache.cull(key, screen))
    # The same snapped corners on a finer screen, as far as its guard band reaches: near planes cut beyond the image.
    extent = max((int(t.abs().max()) for t in (flat.x, flat.y) if len(t)), default=0)
    finer = next(n for n in FINER if n == 1 or n * extent <= GUARD)
    width, height = camera.width * finer, camera.height * finer
    flat = replace(flat, x=flat.x * finer, y=flat.y * finer)
    parts = visible_areas(flat, Window(0, 0, width, height), width)
    twin = TwinLight(bodies, camera, light)
    lit = [twin(part.triangle.numpy(), *((t / finer).numpy() for t in (part.x, part.y))) for part in parts]
    parts = Fragments.join(parts)
    column, row = parts.pixel % width // finer, parts.pixel // width // finer
    area = parts.area.double() / finer**2
    weight, highlight = (area * torch.from_numpy(np.concatenate(t)) for t in zip(*lit, strict=True))
    entry, own = torch.unique(
        (row * camera.width + column) * bodies.triangle_count + parts.triangle, return_inverse=True
    )
    area, weight, highlight = (_sums(own, t, len(entry)) for t in (area, weight, highlight))
    pixel = entry // bodies.triangle_count
    face = torch.from_numpy(bodies.triangle_face.astype(np.int64))[entry % bodies.triangle_count]
    coverage, specular = (_sums(pixel, t, camera.height * camera.width) for t in (area, highlight))
    matrix = ReferenceMatrix(pixel, face, weight, coverage, specular, bodies.face_count)
    areas = replace(matrix, weight=area, specular=torch.zeros_like(coverage))
    return Reference(matrix, areas, _sums(face, area, bodies.face_count))


def _sums(index: Tensor, values: Tensor, count: int) -> Float64[Tensor, " count"]:
    return torch.zeros(count, dtype=torch.float64).index_add_(0, index, values.double())
