"""Views with all but the logo's colours baked into a base image."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float32, Int64, UInt8
from torch import Tensor

from cloak_core.core.cameras import Vector
from cloak_core.core.places import Places
from cloak_core.core.view import BakedView, Subject, View
from cloak_core.core.visibility.backend import backend


def bake(
    view: View,
    logo: Int64[Tensor, " L"],
    colors: Float32[Tensor, "F 3"],
    light_color: Vector,
    texture: UInt8[Tensor, "h w 3"] | None = None,
) -> BakedView:
    """Fold all faces but the logo's, in their colours or the texture's, and the highlight into a base image."""
    stage = backend(view.pixels.device)
    pixels, coverage, base_color, front_count, shown = stage.split(view, logo, colors, light_color, texture)
    if view.cloth is None:
        places = Places.of_faces(len(logo), view.pixels.device)
    else:
        # The logo's entries keep their order; each is a place of its own.
        is_logo = torch.zeros(len(colors), dtype=torch.bool, device=logo.device).index_fill_(0, logo, True)
        places = Places.on_cloth(shown.column, view.cloth[:, is_logo[view.map.column]], len(logo))
        entries = torch.arange(len(shown), device=logo.device)
        shown = replace(shown, column=entries, width=len(shown), has_own_columns=True)
    own = colors.index_select(0, logo)
    sides = view.height, view.width
    return BakedView(
        *sides, pixels, coverage, base_color, front_count, shown, places, own, light_color, Subject(view.box)
    )
