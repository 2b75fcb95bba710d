"""Views with all but the logo's colours baked into a base image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Float32, Int64, UInt8
from torch import Tensor

from cloak_core.core.cameras import Vector
from cloak_core.core.linear import SparseMap, offsets
from cloak_core.core.places import Places
from cloak_core.core.view import BakedView, Box, Subject, View, box_of
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


def baked_view(
    pixel: Int64[Tensor, " E"],
    face: Int64[Tensor, " E"],
    weight: Float32[Tensor, " E"],
    logo_count: int,
    base_image: Float[Tensor, "3 H W"],
    coverage: Float[Tensor, "H W"] | None = None,
    box: Box | None = None,
    mask: Bool[Tensor, "H W"] | None = None,
    light_color: Vector = (1.0, 1.0, 1.0),
    provenance: Mapping[str, object] | None = None,
    others: tuple[Box, ...] | None = None,
) -> BakedView:
    """Make a baked view from plain tensors, without pose or camera.

    image[pixel] = base_image[pixel] + sum(weight * logo color[face]) + (1 - coverage[pixel]) * background[pixel].

    pixel: flat, y * W + x, in any order. face: positions in the logo, 0 .. logo_count - 1. weight: the face's
    share of the pixel times the shading there. base_image: what the pixel shows beside the logo, so a photograph
    times (1 - the logo's share). coverage: in [0, 1], None: 1 everywhere, the background is not seen. box: the
    person's; where absent, that of the mask, else of the pixels at least half covered. Raises ValueError where
    sizes do not match or an index is out of range.
    """
    _, height, width = base_image.shape
    count = height * width
    if not len(pixel) == len(face) == len(weight):
        raise ValueError(f"{len(pixel)} pixels, {len(face)} faces, {len(weight)} weights")
    for name, index, limit in (("pixel", pixel, count), ("face", face, logo_count)):
        if len(index) and not 0 <= int(index.min()) <= int(index.max()) < limit:
            raise ValueError(f"{name}: {int(index.min())} .. {int(index.max())} is not within 0 .. {limit - 1}")
    device = pixel.device
    cover = torch.ones(count) if coverage is None else coverage.reshape(-1).float()
    cover = cover.to(device)
    per_pixel = torch.bincount(pixel, minlength=count)
    kind = torch.where(per_pixel > 0, 0, torch.where(cover <= 0, 3, torch.where(cover < 1, 1, 2)))
    logo, edge, inside = ((kind == number).nonzero()[:, 0] for number in range(3))
    pixels = torch.cat([logo, edge, inside])
    key = pixel * logo_count + face
    if (key[1:] < key[:-1]).any():
        entry = torch.argsort(key, stable=True)
        face = face[entry]
        weight = weight[entry]
    known = (cover >= 0.5).view(height, width) if mask is None else mask
    subject = Subject(
        box_of(known) if box is None else box, others or (), others is None, None if mask is None else lambda: mask
    )
    return BakedView(
        height,
        width,
        pixels,
        cover[pixels],
        base_image.to(device).reshape(3, -1)[:, pixels].float().contiguous(),
        len(logo) + len(edge),
        SparseMap(offsets(torch.repeat_interleave(per_pixel[logo]), len(logo)), face, weight, logo_count),
        Places.of_faces(logo_count, device),
        torch.zeros(logo_count, 3, device=device),
        light_color,
        subject,
        provenance or {},
    )
