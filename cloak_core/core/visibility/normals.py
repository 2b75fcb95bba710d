"""Smooth vertex normals: the area-weighted mean of the normals of the triangles around each vertex."""

from __future__ import annotations

import torch
from jaxtyping import Float32, Float64, Int64
from torch import Tensor

from cloak_core.core.linear import SparseMap, offsets


class NormalOperator:
    """Vertex normals of one topology: each vertex sums the cross products of its triangles."""

    def __init__(self, triangles: Int64[Tensor, "3 T"], vertex_count: int) -> None:
        self.triangles = triangles
        corner = triangles.reshape(-1)
        order = torch.argsort(corner, stable=True)
        ones = torch.ones(len(corner), dtype=torch.float64, device=corner.device)
        count = triangles.shape[1]
        self._sum = SparseMap(offsets(corner, vertex_count), order % count, ones, count)

    def __call__(self, vertices: Float64[Tensor, "3 V"]) -> Float32[Tensor, "3 V"]:
        """Compute unit normals in world space; zero where a vertex has no area around it."""
        if not self.triangles.shape[1]:
            return torch.zeros_like(vertices, dtype=torch.float32)
        a, b, c = (vertices[:, corner].T for corner in self.triangles)
        normals = self._sum.matrix @ torch.linalg.cross(b - a, c - a)
        length = torch.linalg.vector_norm(normals, dim=1, keepdim=True)
        return (normals / torch.where(length > 0, length, 1.0)).T.to(torch.float32).contiguous()
