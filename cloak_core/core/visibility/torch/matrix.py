"""Fragments to a view's matrix, in torch: light at every fragment, then a row for each pixel."""

from __future__ import annotations

import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.core.view import Fragments, Screen, Surface, View
from cloak_core.core.visibility.sparse import offsets
from cloak_core.core.visibility.torch.shading import light_fragments


def build_view(
    found: Fragments,
    screen: Screen,
    surface: Surface,
    normals: Float32[Tensor, "3 V"],
    light_position: Float32[Tensor, " 3"],
) -> View:
    """See `Backend.build_view`."""
    weight, highlight, uv = light_fragments(found, screen, surface, normals, light_position)
    face = surface.face.index_select(0, found.triangle)
    pixels, row = torch.unique_consecutive(found.pixel, return_inverse=True)
    coverage, specular = (
        torch.zeros(len(pixels), device=row.device).index_add_(0, row, t) for t in (found.area, highlight)
    )
    if surface.by_face:
        row, face, weight = _merge_faces(row, face, weight)
    crow = offsets(row, len(pixels))
    return View(screen.height, screen.width, pixels, coverage, specular, crow, face, weight, uv)


def _merge_faces(row: Tensor, face: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sum the weights of a polygon's triangles within each pixel."""
    count = int(face.max()) + 1 if len(face) else 1
    entry, inverse = torch.unique(row * count + face, return_inverse=True)
    row = torch.div(entry, count, rounding_mode="floor")
    return row, entry - row * count, weight.new_zeros(len(entry)).index_add_(0, inverse, weight)
