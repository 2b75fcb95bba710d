"""Hidden surface removal by clipping, in torch, in all pixels at once (after Weiler and Atherton 1977).

From each piece is cut away what every other piece of its pixel hides of it: the part inside the other triangle where
that one is nearer is convex, so everything stays a list of convex polygons. Triangles that pierce each other are cut
along their line. No samples, no tolerance.

Depth is a plane for each piece, three whole numbers: inverse depth at the pixel's corner times 2^42, and its change
over a pixel right and down. Differences of whole numbers do not round, so of any three triangles the order is without
contradiction, and no pixel is filled twice or left open; equal ones go to the lower id.
"""

from __future__ import annotations

import itertools

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from cloak_core.core.visibility.torch.pieces import NOTHING, Pieces, from_corner
from cloak_core.core.visibility.torch.polygons import Line, distances, inner_part, join, measure
from cloak_core.core.visibility.torch.triangles import Triangles, expand

MOST_PIECES = 4096
"""Pieces of a pixel that are resolved exactly at most: each is compared with each."""
MOST_CUTS = 1 << 18
"""Tests of a convex part against a triangle in one pixel at most."""


def cut_hidden(
    pieces: Pieces, triangles: Triangles, width: int
) -> tuple[Float64[Tensor, "C 2 N"], Int64[Tensor, " N"], Bool[Tensor, " P"]]:
    """Cut away what is hidden of pieces, sorted by place: convex parts, the piece of each part, and crowded pieces.

    Crowded pieces are those of pixels that take more pieces or cuts than allowed; they have no parts. In each turn
    every piece meets one more piece that may hide it.
    """
    lines = _lines(pieces, triangles, width)
    name = triangles.ids.index_select(0, pieces.owner)
    _, pixel, size = torch.unique_consecutive(pieces.place, return_inverse=True, return_counts=True)
    crowded = size > MOST_PIECES
    first, count, hider = _hiders(pieces, torch.where(crowded, 0, size)[pixel], (size.cumsum(0) - size)[pixel])
    shape = pieces.shape
    owner = torch.arange(len(name), device=name.device)
    done = []
    cuts = torch.zeros_like(size)
    for turn in itertools.count():
        finished = count[owner] <= turn
        done.append((shape[..., finished], owner[finished]))
        shape = shape[..., ~finished]
        owner = owner[~finished]
        cuts += torch.bincount(pixel[owner], minlength=len(cuts))
        crowded |= cuts > MOST_CUTS
        going = ~crowded[pixel[owner]]
        shape = shape[..., going]
        owner = owner[going]
        if not len(owner):
            break
        by = hider[first[owner] + turn]
        hiding = [*(tuple(t[by] for t in line) for line in lines), _nearer(pieces, name, by, owner)]
        shape, kept = _subtract(shape, hiding)
        owner = owner[kept]
    shapes, owners = zip(*done, strict=True)
    shape = join(list(shapes))
    owner = torch.cat(owners)
    exact = ~crowded[pixel[owner]]
    return shape[..., exact], owner[exact], crowded[pixel]


def _lines(pieces: Pieces, triangles: Triangles, width: int) -> list[Line]:
    """Compute the three edges of each piece's triangle, from the pixel's corner."""
    pixel = torch.stack([pieces.place % width, torch.div(pieces.place, width, rounding_mode="floor")])
    corners = from_corner(triangles, pieces.owner, pixel)
    lines = []
    for (x0, y0), (x1, y1) in ((corners[0], corners[1]), (corners[1], corners[2]), (corners[2], corners[0])):
        dx, dy = x1 - x0, y1 - y0
        scale = 1 / torch.sqrt(dx * dx + dy * dy)
        a, b = -dy * scale, dx * scale
        lines.append((a, b, -(a * (x0 + x1) + b * (y0 + y1)) * 0.5))  # from the middle, which a neighbour shares
    return lines


def _hiders(pieces: Pieces, rivals: Tensor, begin: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """List the pieces that may hide each piece, sorted by place: first entry, number of entries, the list."""
    (least, most), low, high = pieces.depth_range(), pieces.shape.amin(0), pieces.shape.amax(0)
    others = [begin[:0]]
    count = torch.zeros_like(rivals)
    for own, offset in expand(rivals):
        other = begin[own] + offset
        meet = (own != other) & (most[other] >= least[own] - 1)
        meet &= ((high[:, other] > low[:, own]) & (low[:, other] < high[:, own])).all(0)
        others.append(other[meet])
        count += torch.bincount(own[meet], minlength=len(count))
    return count.cumsum(0) - count, count, torch.cat(others)


def _nearer(pieces: Pieces, name: Tensor, first: Tensor, second: Tensor) -> Line:
    """Compute the line on whose inner side pieces are nearer than others; equal depths go to the lower id."""
    c, a, b = pieces.plane[:, first] - pieces.plane[:, second]
    scale = torch.sqrt(a * a + b * b)
    even = scale == 0
    lower = torch.where(name[first] < name[second], 1.0, -1.0)
    scale = torch.where(even, 1.0, scale)
    return a / scale, b / scale, torch.where(even & (c == 0), lower, c / scale)


def _subtract(
    shape: Float64[Tensor, "C 2 N"], hiding: list[Line]
) -> tuple[Float64[Tensor, "K 2 M"], Int64[Tensor, " M"]]:
    """Subtract from each polygon a convex area, given by its sides; also returns the polygon that each part is of."""
    meet = torch.stack([(distances(shape, line) > 0).any(0) for line in hiding]).all(0)
    apart, own = (~meet).nonzero().view(-1), meet.nonzero().view(-1)
    shapes, owners = [shape.index_select(-1, apart)], [apart]
    rest = shape.index_select(-1, own)
    for line in hiding:
        a, b, c = (t.index_select(0, own) for t in line)
        outside = inner_part(rest, (-a, -b, -c))
        some = (measure(outside)[0] > NOTHING * 1e-6).nonzero().view(-1)
        shapes.append(outside.index_select(-1, some))
        owners.append(own.index_select(0, some))
        rest = inner_part(rest, (a, b, c))
    return join(shapes), torch.cat(owners)
