"""One point light: how much of a face's colour a point shows, and how much highlight is added to it.

PyTorch3D's point light and material under hard Phong shading: colour = surface * (ambient + diffuse * max(0, n.l)) +
specular * max(0, v.r)^shininess, with smooth vertex normals interpolated over the triangle. It is linear in the surface
colour, which is what makes a view a sparse matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32, Float64, Int64
from torch import Tensor

from cloak_core.files.errors import InputError
from cloak_core.render.sparse import csr, offsets
from cloak_core.scene.cameras import Number, Vector


@dataclass(frozen=True)
class Light:
    """A point light and the bodies' material. Raises `InputError` for values that are not finite."""

    ambient: Number = 0.5
    diffuse: Number = 0.3
    specular: Number = 0.2
    shininess: Number = 64.0
    position: Vector = (0.0, 85.0, 100.0)
    """World coordinates, metres."""
    color: Vector = (1.0, 1.0, 1.0)
    """Scales the three channels of everything lit."""

    def __post_init__(self) -> None:
        values = (self.ambient, self.diffuse, self.specular, self.shininess, *self.position, *self.color)
        if not all(math.isfinite(value) for value in values):
            raise InputError(f"light: {values} are not all finite numbers")


class NormalOperator:
    """Smooth vertex normals of one topology: each vertex sums the cross products of its triangles (area-weighted)."""

    def __init__(self, triangles: Int64[Tensor, "3 T"], vertex_count: int) -> None:
        self.triangles = triangles
        corner = triangles.reshape(-1)
        order = torch.argsort(corner, stable=True)
        ones = torch.ones(len(corner), dtype=torch.float64, device=corner.device)
        size = (vertex_count, triangles.shape[1])
        self._sum = csr(offsets(corner, vertex_count), order % triangles.shape[1], ones, size)

    def __call__(self, vertices: Float64[Tensor, "3 V"]) -> Float32[Tensor, "3 V"]:
        """Unit normals in world space; zero where a vertex has no area around it."""
        if not self.triangles.shape[1]:
            return torch.zeros_like(vertices, dtype=torch.float32)
        a, b, c = (vertices[:, corner].T for corner in self.triangles)
        normals = self._sum @ torch.linalg.cross(b - a, c - a)
        length = torch.linalg.vector_norm(normals, dim=1, keepdim=True)
        return (normals / torch.where(length > 0, length, 1.0)).T.to(torch.float32).contiguous()


def shade(
    points: Float[Tensor, "3 N"], normals: Float[Tensor, "3 N"], light_position: Float[Tensor, "xyz=3 #N"], light: Light
) -> tuple[Float[Tensor, " N"], Float[Tensor, " N"]]:
    """Weight of the surface colour and added highlight at points in view space (the camera at the origin).

    normals need not have unit length. Never NaN: a vector of no length counts as facing nowhere.
    """
    normal, toward, away = _unit(normals), _unit(light_position - points), _unit(points)
    cosine = (normal * toward).sum(0)
    # v.r with r = 2 (n.l) n - l, for the negated v.
    reflected = (toward * away).sum(0) - 2 * cosine * (normal * away).sum(0)
    power = torch.where(cosine > 0, reflected.clamp(min=0), 0).pow(light.shininess)
    return light.ambient + light.diffuse * cosine.clamp(min=0), light.specular * power * (cosine > 0)


def _unit(vector: Float[Tensor, "3 N"]) -> Float[Tensor, "3 N"]:
    return vector / torch.linalg.vector_norm(vector, dim=0).clamp(min=1e-20)
