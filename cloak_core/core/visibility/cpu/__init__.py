"""The stages of a render as numba loops, for the CPU; `backend` lists them."""

from cloak_core.core.visibility.cpu.matrix import build_view as build_view
from cloak_core.core.visibility.cpu.painting import draw_bodies as draw_bodies
from cloak_core.core.visibility.cpu.painting import logo_matrix as logo_matrix
from cloak_core.core.visibility.cpu.sampling import cover as cover
from cloak_core.core.visibility.cpu.sampling import merge_samples as merge_samples
