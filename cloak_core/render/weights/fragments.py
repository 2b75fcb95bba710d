"""Fragments: what each triangle contributes to each pixel of a view.

A fragment is what is seen of one triangle within one pixel: its share of the pixel, and a point where it is lit. Here
it is made of the triangle's visible samples, lit at their mean position (with one sample per pixel, the sample itself),
or from exact areas, lit at their centroid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch
from jaxtyping import Float32, Float64, Int64
from torch import Tensor

from cloak_core.render.seam import steps
from cloak_core.render.visibility.flat import Cull, flatten
from cloak_core.render.visibility.keys import EMPTY, ID_BITS, triangle_ids
from cloak_core.render.visibility.projection import Screen, Window
from cloak_core.render.visibility.rasterizer import Visibility


@dataclass(frozen=True)
class Fragments:
    """N fragments of a view, sorted by pixel."""

    pixel: Int64[Tensor, " N"]
    """Flat, y * W + x."""
    triangle: Int64[Tensor, " N"]
    area: Float32[Tensor, " N"]
    """Share of the pixel, in (0, 1]."""
    x: Float64[Tensor, " N"]
    y: Float64[Tensor, " N"]
    """Where they are lit, pixels from the top left corner of the image."""

    @staticmethod
    def join(bands: Sequence[Fragments]) -> Fragments:
        """Of bands of a view, from top to bottom."""
        columns = ([getattr(band, field.name) for band in bands] for field in fields(Fragments))
        return bands[0] if len(bands) == 1 else Fragments(*map(torch.cat, columns))


def area_fragments(screen: Screen, triangles: Int64[Tensor, "3 T"], cull: Cull, window: Window) -> Fragments:
    """Fragments of the one view on the screen by exact area, in closed form, without samples: every triangle is cut by
    the pixels that it touches, and where pieces overlap, by what is nearer.

    triangles, cull and window as for `rasterizer.rasterize`. Warns of `areas.CrowdedPixels`.
    """
    whole = torch.zeros(0, dtype=torch.int64, device=screen.x.device)
    none = whole, whole, whole.to(torch.float32), whole.new_zeros(2, 0).to(torch.float64)
    found = steps(whole.device).seen_areas(flatten(screen, triangles, 0, cull), window, screen.width)
    pixel, triangle, area, center = (torch.cat(column, -1) for column in zip(none, *found, strict=True))
    return Fragments(pixel, triangle, area.float(), *center)


def merge_samples(visibility: Visibility) -> Fragments:
    """The visible samples of every (pixel, triangle) of one view, merged."""
    return steps(visibility.keys.device).merge_samples(visibility)


def merge_in_torch(visibility: Visibility) -> Fragments:
    """`merge_samples`, on any device."""
    keys, n, w = visibility.keys[0], visibility.grid, visibility.window
    row, column = (keys != EMPTY).nonzero(as_tuple=True)
    triangle = triangle_ids(keys[row, column])
    row, column = row + w.y0 * n, column + w.x0 * n
    pixel = torch.div(row, n, rounding_mode="floor") * visibility.width + torch.div(column, n, rounding_mode="floor")
    entry, owner, count = torch.unique(pixel << ID_BITS | triangle, return_inverse=True, return_counts=True)
    x, y = (
        torch.zeros(len(entry), dtype=torch.float64, device=keys.device).index_add_(0, owner, (t + 0.5) / n) / count
        for t in (column.double(), row.double())
    )
    return Fragments(entry >> ID_BITS, entry & ((1 << ID_BITS) - 1), count.to(torch.float32) / (n * n), x, y)
