"""A view dressed for a logo: everything else filled in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float32, Int64, UInt8
from torch import Tensor

from cloak_core.render.compiled import arrays
from cloak_core.render.seam import steps
from cloak_core.render.sparse import csr, offsets
from cloak_core.render.weights.texture import look_up
from cloak_core.render.weights.view import View
from cloak_core.scene.cameras import Vector


@dataclass(frozen=True, eq=False)
class DressedView:
    """A view with everything but the logo's colours filled in: N covered pixels.

    They are ordered by what a render has to do with them: first the M that the logo touches, then, up to
    `front_count`, the others at whose edge the background shows, then the rest.
    """

    height: int
    width: int
    pixels: Int64[Tensor, " N"]
    coverage: Float32[Tensor, " N"]
    planes: Float32[Tensor, "3 N"]
    """The other faces and the highlight, in the light's colour; not clamped."""
    front_count: int
    logo_crow: Int64[Tensor, " M1"]
    """M + 1 row offsets of the logo's matrix, logo pixels x logo faces."""
    logo_face: Int64[Tensor, " E"]
    """Position in the list of logo faces, 0 .. L - 1."""
    logo_weight: Float32[Tensor, " E"]
    logo_count: int
    """L."""
    light_color: Vector
    box: tuple[int, int, int, int]

    @property
    def base(self) -> Float32[Tensor, "N 3"]:
        """`planes` pixel by pixel."""
        return self.planes.T

    @property
    def logo_pixels(self) -> int:
        """M."""
        return len(self.logo_crow) - 1

    @property
    def logo_rows(self) -> Int64[Tensor, " M"]:
        """Rows of `pixels` that the logo touches: the first M."""
        return torch.arange(self.logo_pixels, device=self.pixels.device)

    @cached_property
    def arrays(self) -> list[np.ndarray]:
        """Pixels, coverage, planes and the logo's matrix (row offsets, faces, weights) for loops; the same memory."""
        return arrays(self.pixels, self.coverage, self.planes, self.logo_crow, self.logo_face, self.logo_weight)

    @cached_property
    def transposed(self) -> tuple[Int64[Tensor, " L1"], Int64[Tensor, " E"], Float32[Tensor, " E"]]:
        """The logo's matrix the other way round, faces x logo pixels: row offsets, logo pixel, weight."""
        row = torch.repeat_interleave(self.logo_crow.diff(), output_size=len(self.logo_face))
        order = torch.argsort(self.logo_face, stable=True)
        crow = offsets(self.logo_face, self.logo_count)
        return crow, row.index_select(0, order), self.logo_weight.index_select(0, order)


def dress(
    view: View,
    logo: Int64[Tensor, " L"],
    colors: Float32[Tensor, "F 3"],
    light_color: Vector,
    texture: UInt8[Tensor, "h w 3"] | None = None,
) -> DressedView:
    """Fold all faces but the logo's, in their colours or the texture's, and the highlight into a base image."""
    done = steps(view.pixels.device).split(view, logo, colors, light_color, texture)
    pixels, coverage, planes, front_count, *matrix = done
    return DressedView(
        view.height, view.width, pixels, coverage, planes, front_count, *matrix, len(logo), light_color, view.box
    )


def split(
    view: View, logo: Int64[Tensor, " L"], colors: Float32[Tensor, "F 3"], light_color: Vector, texture: Tensor | None
) -> tuple[Tensor, Tensor, Tensor, int, Tensor, Tensor, Tensor]:
    """A view's arrays to those of a dressed view: pixels, coverage, planes, front_count, and the logo's matrix."""
    pixels, coverage, crow, face, weight = view.pixels, view.coverage, view.crow, view.face, view.weight
    position = torch.full((len(colors),), -1, dtype=torch.int64, device=logo.device)
    position[logo] = torch.arange(len(logo), device=logo.device)
    place = position.index_select(0, face)
    is_logo = place >= 0
    rest = torch.where(is_logo, 0, weight)
    if texture is None:
        worn = csr(crow, face, rest, (len(pixels), len(colors))) @ colors
    else:
        entries = torch.arange(len(face), device=logo.device)
        worn = csr(crow, entries, rest, (len(pixels), len(entries))) @ look_up(texture, view.uv)
    tint = torch.tensor(light_color, device=logo.device)
    planes = ((worn + view.specular.unsqueeze(1)) * tint).T
    entry = is_logo.nonzero().view(-1)
    row = torch.repeat_interleave(crow.diff(), output_size=len(face)).index_select(0, entry)
    per_row = torch.bincount(row, minlength=len(pixels))
    kind = torch.where(per_row > 0, 0, torch.where(coverage < 1, 1, 2))
    order = torch.argsort(kind, stable=True)
    logo_pixels, edge_pixels, _ = torch.bincount(kind, minlength=3).tolist()
    logo_crow = row.new_zeros(logo_pixels + 1)
    logo_crow[1:] = per_row.index_select(0, order[:logo_pixels]).cumsum(0)
    return (
        pixels.index_select(0, order),
        coverage.index_select(0, order),
        planes.index_select(1, order).contiguous(),
        logo_pixels + edge_pixels,
        logo_crow,
        place.index_select(0, entry),
        weight.index_select(0, entry),
    )
