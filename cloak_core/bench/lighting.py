"""The light's plain twin: the formula of `render.torch.shading`, in float64, ray by ray in world space."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from cloak_core.exchange.bodies import Bodies
from cloak_core.render.settings import Light
from cloak_core.scene.cameras import Camera
from cloak_core.scene.geometry import vertex_normals

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
