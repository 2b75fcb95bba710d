"""The reference that views are judged by, with its light and without.

Exact areas wherever they are in reach: what is seen of each triangle in each pixel, hidden parts clipped away in
float64 (`bench.exact`), with the light over it, integrated by the light's float64 twin (`bench.lighting`). Where too
many triangles overlap for that, 64 x 64 samples per pixel: the view rendered 8 times as large with 64 samples per
pixel, blocks of 8 x 8 pixels averaged.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from cloak_core.bench.exact import OutOfReach, Seen, seen_areas
from cloak_core.bench.lighting import TwinLight
from cloak_core.exchange.bodies import Bodies
from cloak_core.render.views import ViewBank
from cloak_core.render.visibility.projection import Screen, project
from cloak_core.render.weights.shading import Light
from cloak_core.render.weights.view import View
from cloak_core.scene.cameras import Camera
from cloak_core.scene.geometry import is_closed, is_outward

EXACT, SAMPLED = "exact areas, clipped in float64", "64 x 64 samples per pixel"
_CHUNK = 1 << 18
FACTOR = 8
"""Times as large, and samples along a pixel's side, where samples have to do."""
FINER = (1, 4)
"""Into how many parts the sides of pixels are cut until exact areas come into reach."""


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
        """Of sum(upstream * image before clamping) with respect to the face colours, float64."""
        result = torch.zeros(self.face_count, 3, dtype=torch.float64)
        return result.index_add_(0, self.face, self.weight.double().unsqueeze(1) * upstream.double()[self.pixel])


def matrix_of(view: View, face_count: int) -> Matrix:
    """The matrix of a view."""
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
    """Pixels of each face that are seen."""
    how: str
    """`EXACT` or `SAMPLED`."""


def reference(bodies: Bodies, camera: Camera, light: Light, pose: int = 0) -> Reference:
    """By exact areas where they are in reach, else by samples. Takes seconds to minutes."""
    for parts in FINER:
        with contextlib.suppress(OutOfReach):
            return exact(bodies, camera, light, pose, parts)
    return sampled(bodies, camera, light, pose)


def exact(bodies: Bodies, camera: Camera, light: Light, pose: int = 0, parts: int = 1) -> Reference:
    """By clipping. Raises `OutOfReach` where too many triangles overlap.

    parts: pixels are cut into parts x parts small ones first, which leaves fewer triangles in each.
    """
    fine = replace(camera, width=camera.width * parts, height=camera.height * parts)
    screen = screen_of_pose(bodies, fine, pose)
    triangles = torch.from_numpy(bodies.triangles.T.astype(np.int64))
    cull = closed_outward(bodies, pose) and bool((screen.view[2] >= screen.near).all())
    seen = seen_areas(screen, triangles, cull)
    share = 1 / parts**2
    weight, highlight = (t * share for t in _lit(seen, bodies, fine, light, pose))
    face = torch.from_numpy(bodies.triangle_face.astype(np.int64))[seen.triangle]
    pixel, area = _coarse(fine, parts)[seen.pixel], seen.area * share
    coverage, specular = (_sums(pixel, t, camera.height * camera.width) for t in (area, highlight))
    matrix = Matrix(pixel, face, weight, coverage, specular, bodies.face_count)
    areas = replace(matrix, weight=area, specular=torch.zeros_like(coverage))
    return Reference(matrix, areas, _sums(face, area, bodies.face_count), EXACT)


def _coarse(large: Camera, factor: int) -> Int64[Tensor, " pixels"]:
    """The pixel of an image `factor` times smaller that each pixel lies in."""
    index = torch.arange(large.height * large.width)
    row = torch.div(index, large.width * factor, rounding_mode="floor")
    return row * (large.width // factor) + torch.div(index % large.width, factor, rounding_mode="floor")


def _sums(index: Tensor, values: Tensor, count: int) -> Float64[Tensor, " count"]:
    return torch.zeros(count, dtype=torch.float64).index_add_(0, index, values.double())


def _lit(seen: Seen, bodies: Bodies, camera: Camera, light: Light, pose: int) -> tuple[Tensor, Tensor]:
    """Weight and highlight of each part: the light's integral over it."""
    twin = TwinLight(bodies, camera, light, pose)
    sums = torch.zeros(2, len(seen.pixel), dtype=torch.float64)
    part, x, y, area = seen.shape.quadrature()
    for chunk in (slice(i, i + _CHUNK) for i in range(0, len(part), _CHUNK)):
        own = part[chunk]
        pixel = seen.pixel[own]
        column = pixel % camera.width
        place = (x[chunk] + column, y[chunk] + (pixel - column) / camera.width)
        values = twin(*(t.numpy() for t in (seen.triangle[own], *place)))
        for total, value in zip(sums, values, strict=True):
            total.index_add_(0, own, torch.from_numpy(value) * area[chunk])
    return sums[0], sums[1]


def screen_of_pose(bodies: Bodies, camera: Camera, pose: int = 0) -> Screen:
    """The pose's vertices on the camera's screen."""
    vertices = bodies.vertices[pose].astype(np.float64)
    pivot = camera.pivot or tuple(((vertices.min(0) + vertices.max(0)) / 2).tolist())
    return project(torch.from_numpy(vertices.T.copy()).unsqueeze(0), [camera], [pivot])


def closed_outward(bodies: Bodies, pose: int = 0) -> bool:
    """Whether triangles that show their back can be left out, unless the near plane cuts the body open."""
    return is_closed(bodies.triangles) and bool(np.asarray(is_outward(bodies))[pose])


def sampled(bodies: Bodies, camera: Camera, light: Light, pose: int = 0) -> Reference:
    """By 64 x 64 samples per pixel, each lit on its own small piece of surface: off by less than 1/64 of a pixel's
    edge length for every edge that crosses it."""
    matrix = _sampled(bodies, camera, light, pose)
    areas = _sampled(bodies, camera, Light(ambient=1.0, diffuse=0.0, specular=0.0), pose)
    return Reference(matrix, areas, _sums(areas.face, areas.weight, bodies.face_count), SAMPLED)


def _sampled(bodies: Bodies, camera: Camera, light: Light, pose: int) -> Matrix:
    bank = ViewBank(bodies, light, samples=64, memory_bytes=1)
    large = replace(camera, width=camera.width * FACTOR, height=camera.height * FACTOR)
    fine = matrix_of(bank.build([(pose, large)])[0], bodies.face_count)
    coarse = _coarse(large, FACTOR)
    share = 1 / FACTOR**2
    key, entry = torch.unique(coarse[fine.pixel] * bodies.face_count + fine.face, return_inverse=True)
    weight = _sums(entry, fine.weight.double() * share, len(key))
    coverage, specular = (
        _sums(coarse, values.double() * share, camera.height * camera.width)
        for values in (fine.coverage, fine.specular)
    )
    pixel = torch.div(key, bodies.face_count, rounding_mode="floor")
    return Matrix(pixel, key - pixel * bodies.face_count, weight, coverage, specular, bodies.face_count)
