"""Views with all but the logo's colours baked into a base image."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float32, Int64, UInt8
from torch import Tensor

from cloak_core.core.cameras import Vector
from cloak_core.core.linear import SparseMap
from cloak_core.core.places import Places
from cloak_core.core.view import BakedView, Subject, View
from cloak_core.core.visibility.texture import look_up


def bake(
    view: View,
    logo: Int64[Tensor, " L"],
    colors: Float32[Tensor, "F 3"],
    light_color: Vector,
    texture: UInt8[Tensor, "h w 3"] | None = None,
) -> BakedView:
    """Fold all faces but the logo's, in their colours or the texture's, and the highlight into a base image."""
    device = view.pixels.device
    position = torch.full((len(colors),), -1, dtype=torch.int64, device=device)
    position[logo] = torch.arange(len(logo), device=device)
    worn = position.index_select(0, view.map.column)
    is_worn = worn >= 0
    if texture is None:
        body = view.map.apply(colors.index_fill(0, logo, 0.0))
    else:  # each entry has a colour of its own
        rest, entries = view.map.weight.masked_fill(is_worn, 0), torch.arange(len(worn), device=device)
        body = SparseMap(view.map.crow, entries, rest, len(worn)).apply(look_up(texture, view.uv))
    base_color = ((body + view.specular.unsqueeze(1)) * torch.tensor(light_color, device=device)).T

    # The order of `BakedView`: pixels that show the logo, others that the background shows through, the rest.
    entry = is_worn.nonzero().view(-1)
    before = torch.cat([entry.new_zeros(1), is_worn.cumsum(0)])  # entries of the logo up to each entry
    per_row = before.index_select(0, view.map.crow).diff()
    kind = torch.where(per_row > 0, 0, torch.where(view.coverage < 1, 1, 2))
    logo_pixels, edge_pixels, inner_pixels = ((kind == number).nonzero().view(-1) for number in range(3))
    order = torch.cat([logo_pixels, edge_pixels, inner_pixels])
    crow = entry.new_zeros(len(logo_pixels) + 1)
    crow[1:] = per_row.index_select(0, logo_pixels).cumsum(0)
    shown = SparseMap(crow, worn.index_select(0, entry), view.map.weight.index_select(0, entry), len(logo))
    if view.cloth is None:
        places = Places.of_faces(len(logo), device)
    else:
        # The logo's entries keep their order; each is a place of its own.
        places = Places.on_cloth(shown.column, view.cloth.index_select(1, entry), len(logo))
        shown = replace(shown, column=torch.arange(len(entry), device=device), width=len(entry), has_own_columns=True)
    return BakedView(
        view.height,
        view.width,
        view.pixels.index_select(0, order),
        view.coverage.index_select(0, order),
        base_color.index_select(1, order).contiguous(),
        len(logo_pixels) + len(edge_pixels),
        shown,
        places,
        colors.index_select(0, logo),
        light_color,
        Subject(view.box),
    )
