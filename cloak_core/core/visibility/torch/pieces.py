"""The pieces of triangles in pixels, in torch: every triangle is cut by the pixels that it touches."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from cloak_core.core.visibility.screen import GRID
from cloak_core.core.visibility.torch.polygons import inner_part, join, measure
from cloak_core.core.visibility.torch.triangles import Triangles, expand_boxes

NOTHING = 1e-9
"""Share of a pixel below which a piece is dropped."""
DEPTH_STEPS = 1 << 42
"""Steps of inverse depth that are told apart."""
_MARGIN = 64.0
"""Steps by which a piece must lie behind a triangle that fills its pixel to be dropped at once."""


@dataclass(frozen=True)
class Pieces:
    """P overlaps of a triangle with a pixel."""

    place: Int64[Tensor, " P"]
    """Flat, y * W + x."""
    owner: Int64[Tensor, " P"]
    """Of the triangles in canonical order."""
    shape: Float64[Tensor, "C 2 P"]
    """Corners, counted from the pixel's."""
    plane: Float64[Tensor, "3 P"]
    """Inverse depth in steps: at the pixel's corner, change over a pixel right, change over one down."""

    def take(self, index: Int64[Tensor, " K"]) -> Pieces:
        """Select some of the pieces."""
        return Pieces(*(t.index_select(-1, index) for t in (self.place, self.owner, self.shape, self.plane)))

    def join(self, other: Pieces) -> Pieces:
        """These pieces, then the others."""
        place, owner, plane = (
            torch.cat([getattr(self, name), getattr(other, name)], -1) for name in ("place", "owner", "plane")
        )
        return Pieces(place, owner, join([self.shape, other.shape]), plane)

    def depth_range(self) -> tuple[Float64[Tensor, " P"], Float64[Tensor, " P"]]:
        """Least and greatest inverse depth of each piece, in steps."""
        depth = self.plane[0] + (self.plane[1:] * self.shape).sum(1)
        return depth.amin(0), depth.amax(0)


def find_pieces(triangles: Triangles, box: Int64[Tensor, "4 N"], top: int, bottom: int, width: int) -> Pieces:
    """Find all pieces in a band of rows, except those behind a triangle that fills their pixel."""
    c0, c1, r0, r1 = box
    first, last = r0.clamp(min=top), r1.clamp(max=bottom - 1)
    pieces = None
    front = torch.full(((bottom - top) * width,), -torch.inf, dtype=torch.float64, device=box.device)
    size = torch.stack([c1 - c0 + 1, (last - first + 1).clamp(min=0)])
    for own, pixel in expand_boxes(torch.stack([c0, first]), size):
        new = _cut_to_pixels(triangles, own, pixel, width)
        full = torch.where(measure(new.shape)[0] > 1 - 1e-12, new.depth_range()[0], -torch.inf)
        front.scatter_reduce_(0, new.place - top * width, full, "amax")
        pieces = new if pieces is None else pieces.join(new)
        ahead = pieces.depth_range()[1] + _MARGIN >= front.index_select(0, pieces.place - top * width)
        pieces = pieces.take(ahead.nonzero().view(-1))
    return pieces


def _cut_to_pixels(triangles: Triangles, own: Tensor, pixel: Int64[Tensor, "xy=2 P"], width: int) -> Pieces:
    """Cut triangles to pixels; pieces without area are left out."""
    shape = from_corner(triangles, own, pixel)
    column, row = pixel
    one, zero = torch.ones_like(shape[0, 0]), torch.zeros_like(shape[0, 0])
    for side in ((one, zero, zero), (-one, zero, one), (zero, one, zero), (zero, -one, one)):
        shape = inner_part(shape, side)
    start, right, down = (
        torch.round(triangles.inverse_depth_at(own, *triangles.edges(own, place * GRID)) * DEPTH_STEPS)
        for place in (pixel, torch.stack([column + 1, row]), torch.stack([column, row + 1]))
    )
    pieces = Pieces(row * width + column, own, shape, torch.stack([start, right - start, down - start]))
    return pieces.take((measure(shape)[0] > NOTHING).nonzero().view(-1))


def from_corner(triangles: Triangles, own: Tensor, pixel: Int64[Tensor, "xy=2 P"]) -> Float64[Tensor, "3 2 P"]:
    """Compute triangles' corners in pixels, from the corner of a pixel."""
    corners = triangles.corners.index_select(2, own) - (pixel * GRID).unsqueeze(1)
    return (corners.to(torch.float64) / GRID).transpose(0, 1)
