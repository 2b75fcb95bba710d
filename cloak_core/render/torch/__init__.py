"""The stages of `backend.Backend` in torch operations, for any device."""

from cloak_core.render.torch.areas import visible_areas
from cloak_core.render.torch.baking import split
from cloak_core.render.torch.cloth import squares_under
from cloak_core.render.torch.matrix import build_view
from cloak_core.render.torch.painting import draw_bodies, logo_matrix
from cloak_core.render.torch.sampling import cover, merge_samples

__all__ = [
    "build_view",
    "cover",
    "draw_bodies",
    "logo_matrix",
    "merge_samples",
    "split",
    "squares_under",
    "visible_areas",
]
