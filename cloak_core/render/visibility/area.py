"""Fragments by exact area: how much of each pixel shows each triangle.

Every triangle is cut by the pixels that it touches, and where pieces overlap, by what is nearer: all of it in closed
form, float64, without samples. On the CPU by compiled loops (visibility/area_loops.py), elsewhere in torch
(visibility/areas.py).
"""

from __future__ import annotations

import warnings

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from cloak_core.render.compiled import use_loops
from cloak_core.render.visibility import area_loops
from cloak_core.render.visibility.areas import seen_areas
from cloak_core.render.visibility.flat import flatten
from cloak_core.render.visibility.projection import Screen, Window
from cloak_core.render.weights.fragments import Fragments


class CrowdedPixels(UserWarning):
    """Pixels in which so many pieces are seen that they were given up: what they show is not exact."""

    def __init__(self, pixels: int) -> None:
        super().__init__(f"{pixels} pixels show too many pieces to be exact")
        self.pixels = pixels


def area_fragments(
    screen: Screen, triangles: Int64[Tensor, "3 T"], cull: Bool[Tensor, " B"] | None, window: Window
) -> Fragments:
    """Fragments whose area is what is seen of a triangle in a pixel, each with its centroid as the place to light it.

    triangles, cull and window as for `rasterizer.rasterize`. Warns of `CrowdedPixels`.
    """
    parts = []
    for view in range(len(screen.x)):
        flat, culled = flatten(screen, triangles, view), cull is not None and bool(cull[view])
        if use_loops(screen.x.device):
            found, given_up = area_loops.seen_areas(flat.arrays(), culled, window, screen.width)
            if given_up:
                warnings.warn(CrowdedPixels(given_up), stacklevel=2)
            found = [tuple(map(torch.from_numpy, band)) for band in found]
        else:
            found = list(seen_areas(flat, culled, window, screen.width))
        parts += [(torch.full_like(band[0], view), *band) for band in found]
    if not parts:
        whole = torch.zeros(0, dtype=torch.int64, device=screen.x.device)
        real = whole.to(torch.float64)
        parts = [(whole, whole, whole, real, real.new_zeros(2, 0))]
    view, pixel, triangle, area, center = (torch.cat(column, -1) for column in zip(*parts, strict=True))
    return Fragments(view, pixel, triangle, area.float(), *center)
