"""A view split into the logo's matrix and the base colors, in torch."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from cloak_core.core.cameras import Vector
from cloak_core.core.linear import SparseMap
from cloak_core.core.view import View
from cloak_core.core.visibility.texture import look_up


def split(
    view: View, logo: Int64[Tensor, " L"], colors: Float32[Tensor, "F 3"], light_color: Vector, texture: Tensor | None
) -> tuple[Tensor, Tensor, Tensor, int, SparseMap]:
    """Split a view into the logo's map and the base colours.

    Returns pixels, coverage, base_color, front_count and map of a `BakedView`.
    """
    pixels, coverage = view.pixels, view.coverage
    crow, face, weight = view.map.crow, view.map.column, view.map.weight
    position = torch.full((len(colors),), -1, dtype=torch.int64, device=logo.device)
    position[logo] = torch.arange(len(logo), device=logo.device)
    place = position.index_select(0, face)
    is_logo = place >= 0
    rest = torch.where(is_logo, 0, weight)
    if texture is None:
        worn = replace(view.map, weight=rest).matrix @ colors
    else:
        entries = torch.arange(len(face), device=logo.device)
        worn = SparseMap(crow, entries, rest, len(entries)).matrix @ look_up(texture, view.uv)
    tint = torch.tensor(light_color, device=logo.device)
    base_color = ((worn + view.specular.unsqueeze(1)) * tint).T
    entry = is_logo.nonzero().view(-1)
    row = view.map.row.index_select(0, entry)
    per_row = torch.bincount(row, minlength=len(pixels))
    kind = torch.where(per_row > 0, 0, torch.where(coverage < 1, 1, 2))
    order = torch.argsort(kind, stable=True)
    logo_pixels, edge_pixels, _ = torch.bincount(kind, minlength=3).tolist()
    logo_crow = row.new_zeros(logo_pixels + 1)
    logo_crow[1:] = per_row.index_select(0, order[:logo_pixels]).cumsum(0)
    return (
        pixels.index_select(0, order),
        coverage.index_select(0, order),
        base_color.index_select(1, order).contiguous(),
        logo_pixels + edge_pixels,
        SparseMap(logo_crow, place.index_select(0, entry), weight.index_select(0, entry), len(logo)),
    )
