"""Fragments to a view's matrix, in torch: light at every fragment, then a row for each pixel.

On CUDA one Triton kernel lights bodies without textures and cloths.
"""

from __future__ import annotations

import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.core.linear import SparseMap, offsets
from cloak_core.core.view import Fragments, Screen, Surface, View
from cloak_core.core.visibility.compiled import use_kernels
from cloak_core.core.visibility.torch.shading import light_fragments


def build_view(
    fragments: Fragments,
    screen: Screen,
    surface: Surface,
    normals: Float32[Tensor, "3 V"],
    light_position: Float32[Tensor, " 3"],
) -> View:
    """Light the fragments of one view, or a band of it, and sum them up to its matrix.

    normals (of the vertices) and light position are in view space.
    """
    light = light_fragments
    if use_kernels(normals.device) and surface.corner_uv is None and surface.corner_cloth is None:
        from cloak_core.core.visibility.fused.shading import light_fragments as light  # needs Triton
    weight, highlight, uv, cloth = light(fragments, screen, surface, normals, light_position)
    face = surface.face.index_select(0, fragments.triangle)
    pixels, row = torch.unique_consecutive(fragments.pixel, return_inverse=True)
    lit = torch.stack([fragments.area, highlight])
    coverage, specular = torch.zeros(2, len(pixels), device=row.device).index_add_(1, row, lit)
    if surface.by_face:
        row, face, weight = _merge_faces(row, face, weight)
    entries = SparseMap(offsets(row, len(pixels)), face, weight, surface.face_count)
    return View(screen.height, screen.width, pixels, coverage, specular, entries, uv, cloth)


def _merge_faces(row: Tensor, face: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sum the weights of a polygon's triangles within each pixel."""
    count = int(face.max()) + 1 if len(face) else 1
    entry, inverse = torch.unique(row * count + face, return_inverse=True)
    row = torch.div(entry, count, rounding_mode="floor")
    return row, entry - row * count, weight.new_zeros(len(entry)).index_add_(0, inverse, weight)
