"""The stages of a render in torch operations, for any device; `backend` lists them."""

from cloak_core.core.visibility.torch.matrix import build_view as build_view
from cloak_core.core.visibility.torch.painting import draw_bodies as draw_bodies
from cloak_core.core.visibility.torch.painting import logo_matrix as logo_matrix
from cloak_core.core.visibility.torch.sampling import cover as cover
from cloak_core.core.visibility.torch.sampling import merge_samples as merge_samples
