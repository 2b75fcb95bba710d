"""Visibility by exact area, in torch, band by band of rows: memory is that of one band."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from cloak_core.core.view import CrowdedPixels, FlatTriangles, Fragments, Window
from cloak_core.core.visibility.screen import GRID
from cloak_core.core.visibility.torch.hidden_parts import cut_hidden
from cloak_core.core.visibility.torch.pieces import NOTHING, Pieces, find_pieces
from cloak_core.core.visibility.torch.polygons import measure
from cloak_core.core.visibility.torch.sampling import sample_pixel
from cloak_core.core.visibility.torch.triangles import Triangles, canonical, chunk_size


def visible_areas(flat: FlatTriangles, window: Window, width: int) -> Iterator[Fragments]:
    """See `Backend.visible_areas`."""
    sampled = 0
    for parts in visible_parts(flat, window, width):
        places = parts.pieces.place[parts.crowded].unique().tolist()
        sampled += len(places)
        fragments = Fragments.join(
            [_measured(parts, width), *(_sampled(at, parts, width) for at in places)], flat.x.device
        )
        order = torch.argsort(fragments.pixel, stable=True)
        yield Fragments(*(getattr(fragments, column.name)[order] for column in fields(fragments)))
    if sampled:
        warnings.warn(CrowdedPixels(sampled), stacklevel=2)


@dataclass(frozen=True)
class Parts:
    """What is visible in a band of rows, as convex parts of pieces."""

    triangles: Triangles
    pieces: Pieces
    """Sorted by place and triangle."""
    shape: Float64[Tensor, "C 2 N"]
    """Corners of N parts, counted from the pixel's corner."""
    owner: Int64[Tensor, " N"]
    """The piece of each part."""
    crowded: Bool[Tensor, " P"]
    """Pieces of pixels that are too crowded to be exact; they have no parts."""


def visible_parts(flat: FlatTriangles, window: Window, width: int) -> Iterator[Parts]:
    """Cut out what is visible in a window of an image `width` pixels wide, from top to bottom."""
    triangles = canonical(flat)
    x, y = triangles.corners
    box = torch.stack([*_touched(x, window.x0, window.x1), *_touched(y, window.y0, window.y1)])
    some = (torch.minimum(box[1] - box[0], box[3] - box[2]) >= 0).nonzero().view(-1)
    triangles = triangles.take(some)
    box = box.index_select(1, some)
    for top, bottom in _bands(box, window, chunk_size(box.device)):
        pieces = find_pieces(triangles, box, top, bottom, width)
        names = triangles.ids.index_select(0, pieces.owner)
        order = torch.argsort(names, stable=True)
        pieces = pieces.take(order[torch.argsort(pieces.place[order], stable=True)])
        yield Parts(triangles, pieces, *cut_hidden(pieces, triangles, width))


def _sampled(place: int, parts: Parts, width: int) -> Fragments:
    """Sample the visible shares of a crowded pixel."""
    own = parts.triangles.take(parts.pieces.owner[parts.pieces.place == place])
    return sample_pixel(own, place % width, place // width, width)


def _touched(position: Int64[Tensor, "3 N"], first: int, stop: int) -> tuple[Tensor, Tensor]:
    """Find the first and last pixel that triangles touch along one axis."""
    low, high = position.amin(0) // GRID, (position.amax(0) - 1) // GRID
    return low.clamp(min=first), high.clamp(max=stop - 1)


def _bands(box: Int64[Tensor, "4 N"], window: Window, most: int) -> Iterator[tuple[int, int]]:
    """Yield bands of rows, from .. to (exclusive), of at most `most` pairs of triangle and pixel, or of one row."""
    left, right, top, bottom = box
    load = torch.zeros(window.y1 - window.y0 + 1, dtype=torch.int64, device=box.device)
    load.index_add_(0, top - window.y0, right - left + 1).index_add_(0, bottom + 1 - window.y0, left - right - 1)
    start = window.y0
    held = 0
    for row, pairs in enumerate(load.cumsum(0)[:-1].tolist(), window.y0):
        if held and held + pairs > most:
            yield start, row
            start = row
            held = 0
        held += pairs
    if held:
        yield start, window.y1


def _measured(parts: Parts, width: int) -> Fragments:
    """Measure area and centroid of the visible parts of each piece."""
    pieces = parts.pieces
    total = torch.zeros(3, len(pieces.place), dtype=torch.float64, device=parts.owner.device)
    total.index_add_(1, parts.owner, measure(parts.shape))
    some = (total[0] > NOTHING).nonzero().view(-1)
    place, (area, *moments) = pieces.place[some], total[:, some]
    corner = torch.stack([place % width, torch.div(place, width, rounding_mode="floor")])
    middle = (torch.stack(moments) / area).clamp(0, 1) + corner
    return Fragments(place, parts.triangles.ids[pieces.owner[some]], area.float(), *middle)
