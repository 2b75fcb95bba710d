"""The stages of `backend.Backend` for CUDA, two of them as one Triton kernel each; the others are torch's."""

from cloak_core.core.visibility.fused.matrix import build_view
from cloak_core.core.visibility.fused.sampling import cover
from cloak_core.core.visibility.torch import (
    draw_bodies,
    logo_matrix,
    merge_samples,
    split,
    visible_areas,
)

__all__ = [
    "build_view",
    "cover",
    "draw_bodies",
    "logo_matrix",
    "merge_samples",
    "split",
    "visible_areas",
]
