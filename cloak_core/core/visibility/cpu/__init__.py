"""The stages of `backend.Backend` as numba loops, for the CPU."""

from cloak_core.core.visibility.cpu.areas import visible_areas
from cloak_core.core.visibility.cpu.baking import split
from cloak_core.core.visibility.cpu.matrix import build_view
from cloak_core.core.visibility.cpu.painting import draw_bodies, logo_matrix
from cloak_core.core.visibility.cpu.sampling import cover, merge_samples

__all__ = [
    "build_view",
    "cover",
    "draw_bodies",
    "logo_matrix",
    "merge_samples",
    "split",
    "visible_areas",
]
