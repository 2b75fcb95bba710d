"""Fragments to a view's matrix, lit by one kernel where bodies have neither textures nor a cloth."""

from __future__ import annotations

from jaxtyping import Float32
from torch import Tensor

from cloak_core.core.view import Fragments, Screen, Surface, View
from cloak_core.core.visibility.fused import shading as fused
from cloak_core.core.visibility.torch import matrix, shading


def build_view(
    fragments: Fragments,
    screen: Screen,
    surface: Surface,
    normals: Float32[Tensor, "3 V"],
    light_position: Float32[Tensor, " 3"],
) -> View:
    """See `Backend.build_view`."""
    is_plain = surface.corner_uv is None and surface.corner_cloth is None
    light = fused.light_fragments if is_plain else shading.light_fragments
    return matrix.assemble(fragments, screen, surface, *light(fragments, screen, surface, normals, light_position))
