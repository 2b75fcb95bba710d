"""Where a device chooses. Each step of rendering stands twice: as compiled loops, for the CPU, and as torch operations,
plain and for any device. Both give the same face ids, bit for bit, and the same weights within 1e-6; the tests hold the
loops against torch (`compiled.torch_alone`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import torch

from cloak_core.render.compiled import use_loops

# Steps import their types from rooms that ask here who does them: so these are looked up at the first call.


@dataclass(frozen=True)
class Steps:
    """Who does what, in the order of a render; each is documented where it stands in torch."""

    project: Callable
    """Vertices to the snapped screen: visibility/projection.py."""
    cover: Callable
    """The nearest triangle at every sample: visibility/samples.py."""
    seen_areas: Callable
    """Shares of pixels: visibility/areas.py."""
    merge_samples: Callable
    """Samples to fragments: weights/fragments.py."""
    build_view: Callable
    """Fragments to light to a view's matrix: weights/matrix.py."""
    split: Callable
    """A view's logo and all the rest: images/dressing.py."""
    draw_bodies: Callable
    """The rest into a canvas: images/painting.py."""
    logo_matrix: Callable
    """The logo into a canvas, and its gradient: images/painting.py."""
    lay_image: Callable
    """A photograph into a canvas: images/backdrop.py."""


def steps(device: torch.device) -> Steps:
    """The steps as they are done on a device."""
    return _loops() if use_loops(device) else _plain()


@cache
def _plain() -> Steps:
    from cloak_core.render.images import backdrop, dressing, painting
    from cloak_core.render.visibility import areas, projection, samples
    from cloak_core.render.weights import fragments, matrix

    return Steps(
        projection.project_rows,
        samples.cover,
        areas.seen_areas,
        fragments.merge_in_torch,
        matrix.build_view,
        dressing.split,
        painting.draw_bodies,
        painting.LogoMatrix.of,
        backdrop.lay_image,
    )


@cache
def _loops() -> Steps:
    from cloak_core.render.images import backdrop, dressing_loops, painting_loops
    from cloak_core.render.visibility import area_loops, covering_loops, projection_loops
    from cloak_core.render.weights import fragments_loops, matrix_loops

    return Steps(
        projection_loops.project_rows,
        covering_loops.cover_view,
        area_loops.seen_areas,
        fragments_loops.merge_samples,
        matrix_loops.build_view,
        dressing_loops.split,
        painting_loops.draw_bodies,
        painting_loops.LogoMatrix.of,
        backdrop.lay_image_by_loop,
    )
