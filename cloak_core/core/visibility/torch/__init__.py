"""The stages of `backend.Backend` in torch operations, for any device."""

from cloak_core.core.visibility.torch.areas import visible_areas
from cloak_core.core.visibility.torch.baking import split
from cloak_core.core.visibility.torch.matrix import build_view
from cloak_core.core.visibility.torch.painting import draw_bodies, logo_matrix
from cloak_core.core.visibility.torch.sampling import cover, merge_samples

__all__ = [
    "build_view",
    "cover",
    "draw_bodies",
    "logo_matrix",
    "merge_samples",
    "split",
    "visible_areas",
]
