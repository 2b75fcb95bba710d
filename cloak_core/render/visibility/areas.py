"""Visibility by exact area, in torch: what is in front of everything else, as shares of pixels.

Every triangle is cut by the pixels that it touches. Then from each of these pieces is cut away what every other piece
of its pixel hides of it: the part inside the other triangle where the other is nearer, which is convex, so everything
stays a list of convex polygons. Triangles that pierce each other are cut along their line. No samples, no tolerance.

Depth is a plane for each piece, three whole numbers: nearness at the pixel's corner times 2^42, and what it changes by
over a pixel right and down. Differences of whole numbers do not round, so of any three triangles the order is without
contradiction, and no pixel is filled twice or left open; equal ones go to the lower id.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, fields

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from cloak_core.render.visibility.flat import FlatTriangles
from cloak_core.render.visibility.polygons import Line, Polygons
from cloak_core.render.visibility.projection import GRID, Window
from cloak_core.render.visibility.samples import Edges, canonical, chunk_size, expand

NOTHING = 1e-9
"""Share of a pixel below which a piece is dropped."""
DEPTH_STEPS = 1 << 42
"""Steps of nearness that are told apart."""
_MARGIN = 64.0
"""Steps by which a piece must lie behind a triangle that fills its pixel to be dropped at once."""


@dataclass(frozen=True)
class Pieces:
    """P overlaps of a triangle with a pixel."""

    place: Int64[Tensor, " P"]
    """Flat, y * W + x."""
    owner: Int64[Tensor, " P"]
    """Of the triangles in canonical order."""
    x: Float64[Tensor, "C P"]
    y: Float64[Tensor, "C P"]
    """Corners, counted from the pixel's (see `Polygons`)."""
    plane: Float64[Tensor, "3 P"]
    """Depth in steps: at the pixel's corner, change over a pixel right, change over one down."""

    def take(self, index: Int64[Tensor, " K"]) -> Pieces:
        return Pieces(*(getattr(self, field.name).index_select(-1, index) for field in fields(self)))

    @staticmethod
    def join(parts: list[Pieces]) -> Pieces:
        shape = Polygons.join([part.shape for part in parts])
        place, owner, plane = (torch.cat([getattr(p, name) for p in parts], -1) for name in ("place", "owner", "plane"))
        return Pieces(place, owner, shape.x, shape.y, plane)

    @property
    def shape(self) -> Polygons:
        return Polygons(self.x, self.y)

    def depth_range(self) -> tuple[Float64[Tensor, " P"], Float64[Tensor, " P"]]:
        start, across, down = self.plane
        depth = start + across * self.x + down * self.y
        return depth.amin(0), depth.amax(0)


Fragments = tuple[Int64[Tensor, " N"], Int64[Tensor, " N"], Float64[Tensor, " N"], Float64[Tensor, "2 N"]]
"""Pixel, triangle, share of the pixel, and the centroid of what is seen, pixels; sorted by pixel and triangle."""


def seen_areas(flat: FlatTriangles, cull: bool, window: Window, width: int) -> Iterator[Fragments]:
    """What is seen of a view in a window of an image so many pixels wide, band by band of rows: memory is that of one.

    cull: whether clockwise triangles are dropped.
    """
    x, y, nearness, ids = canonical(flat, cull)
    box = *_touched(x, window.x0, window.x1), *_touched(y, window.y0, window.y1)
    some = (torch.minimum(box[1] - box[0], box[3] - box[2]) >= 0).nonzero().view(-1)
    x, y, nearness = (t.index_select(1, some) for t in (x, y, nearness))
    ids, *box = (t.index_select(0, some) for t in (ids, *box))
    edges = Edges(x, y, nearness)
    for top, bottom in _bands(box, window, chunk_size(ids.device)):
        pieces = _pieces(x, y, edges, box, top, bottom, width)
        pieces = pieces.take(torch.argsort(pieces.place * len(ids) + pieces.owner))
        for part in _groups(pieces.place, chunk_size(ids.device)):
            own = pieces.take(part)
            yield _measured(own, *_uncovered(own, x, y, ids, width), ids, width)


def _touched(position: Int64[Tensor, "3 N"], first: int, stop: int) -> tuple[Tensor, Tensor]:
    """First and last pixel that triangles touch along one axis."""
    low, high = position.amin(0) // GRID, (position.amax(0) - 1) // GRID
    return low.clamp(min=first), high.clamp(max=stop - 1)


def _bands(box: list[Tensor], window: Window, most: int) -> Iterator[tuple[int, int]]:
    """Rows from .. to (exclusive), each with at most so many pairs of triangle and pixel, or a single row."""
    c0, c1, r0, r1 = box
    load = torch.zeros(window.y1 - window.y0 + 1, dtype=torch.int64, device=c0.device)
    load.index_add_(0, r0 - window.y0, c1 - c0 + 1).index_add_(0, r1 + 1 - window.y0, c0 - c1 - 1)
    start, held = window.y0, 0
    for row, pairs in enumerate(load.cumsum(0)[:-1].tolist(), window.y0):
        if held and held + pairs > most:
            yield start, row
            start, held = row, 0
        held += pairs
    if held:
        yield start, window.y1


def _pieces(x: Tensor, y: Tensor, edges: Edges, box: list[Tensor], top: int, bottom: int, width: int) -> Pieces:
    """All pieces in a band of rows, but those behind a triangle that fills their pixel."""
    c0, c1, r0, r1 = box
    first, last = r0.clamp(min=top), r1.clamp(max=bottom - 1)
    kept = []
    front = torch.full(((bottom - top) * width,), -torch.inf, dtype=torch.float64, device=x.device)
    for owner, down in expand((last - first + 1).clamp(min=0)):
        for pair, across in expand((c1 - c0 + 1).index_select(0, owner)):
            own = owner.index_select(0, pair)
            column, row = c0.index_select(0, own) + across, (first.index_select(0, own) + down.index_select(0, pair))
            new = _cut_to_pixels(x, y, edges, own, column, row, width)
            area, (least, _) = new.shape.measure()[0], new.depth_range()
            full = torch.where(area > 1 - 1e-12, least, -torch.inf)
            front.scatter_reduce_(0, new.place - top * width, full, "amax")
            kept = [_not_behind(front, Pieces.join([*kept, new]), top * width)]
    return kept[0]


def _not_behind(front: Tensor, pieces: Pieces, first: int) -> Pieces:
    ahead = pieces.depth_range()[1] + _MARGIN >= front.index_select(0, pieces.place - first)
    return pieces.take(ahead.nonzero().view(-1))


def _cut_to_pixels(x: Tensor, y: Tensor, edges: Edges, own: Tensor, column: Tensor, row: Tensor, width: int) -> Pieces:
    left, top = column * GRID, row * GRID
    at = lambda t, origin: (t.index_select(1, own) - origin).to(torch.float64) / GRID
    shape = Polygons(at(x, left), at(y, top))
    one, zero = (torch.full_like(shape.x[0], value) for value in (1.0, 0.0))
    for side in ((one, zero, zero), (-one, zero, one), (zero, one, zero), (zero, -one, one)):
        shape = shape.cut(side)
    start, right, down = (
        torch.round(edges.nearness(own, left + i * GRID, top + j * GRID) * DEPTH_STEPS)
        for i, j in ((0, 0), (1, 0), (0, 1))
    )
    plane = torch.stack([start, right - start, down - start])
    pieces = Pieces(row * width + column, own, shape.x, shape.y, plane)
    return pieces.take((shape.measure()[0] > NOTHING).nonzero().view(-1))


def _groups(place: Int64[Tensor, " P"], most: int) -> Iterator[Int64[Tensor, " K"]]:
    """Indices of pieces, pixels kept together, with at most so many pairs within pixels, or a single pixel."""
    size = torch.unique_consecutive(place, return_counts=True)[1].tolist()
    start = stop = pairs = 0
    for count in size:
        if pairs and pairs + count * count > most:
            yield torch.arange(start, stop, device=place.device)
            start, pairs = stop, 0
        stop, pairs = stop + count, pairs + count * count
    if stop > start:
        yield torch.arange(start, stop, device=place.device)


def _lines(pieces: Pieces, x: Tensor, y: Tensor, width: int) -> list[Line]:
    """The three edges of each piece's triangle, from the pixel's corner."""
    left, top = pieces.place % width * GRID, torch.div(pieces.place, width, rounding_mode="floor") * GRID
    px, py = (
        (t.index_select(1, pieces.owner) - origin).to(torch.float64) / GRID for t, origin in ((x, left), (y, top))
    )
    lines = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        dx, dy = px[j] - px[i], py[j] - py[i]
        scale = 1 / torch.sqrt(dx * dx + dy * dy)
        a, b = -dy * scale, dx * scale
        # From the middle, which the edge of a neighbour shares.
        lines.append((a, b, -(a * (px[i] + px[j]) + b * (py[i] + py[j])) * 0.5))
    return lines


def _hiders(pieces: Pieces) -> tuple[Tensor, Tensor, Tensor]:
    """Which pieces may hide which: for each its first entry in a list, how many there are, and the list."""
    _, group, size = torch.unique_consecutive(pieces.place, return_inverse=True, return_counts=True)
    begin, rivals = (size.cumsum(0) - size)[group], size[group]
    least, most = pieces.depth_range()
    spans = [(t.amin(0), t.amax(0)) for t in (pieces.x, pieces.y)]
    found, count = [begin[:0]], torch.zeros_like(rivals)
    for mine, offset in expand(rivals):
        other = begin[mine] + offset
        meet = (mine != other) & (most[other] >= least[mine] - 1)
        for low, high in spans:
            meet &= (high[other] > low[mine]) & (low[other] < high[mine])
        found.append(other[meet])
        count.index_add_(0, mine[meet], torch.ones_like(mine[meet]))
    return count.cumsum(0) - count, count, torch.cat(found)


def _uncovered(pieces: Pieces, x: Tensor, y: Tensor, ids: Tensor, width: int) -> tuple[Polygons, Int64[Tensor, " N"]]:
    """What is seen of pieces: convex parts, and which piece each part belongs to."""
    lines, (first, count, hider) = _lines(pieces, x, y, width), _hiders(pieces)
    name = ids.index_select(0, pieces.owner)
    shape, owner = pieces.shape, torch.arange(len(name), device=name.device)
    done = []
    for turn in itertools.count():
        finished = count[owner] <= turn
        done.append((shape.take(finished.nonzero().view(-1)), owner[finished]))
        left = (~finished).nonzero().view(-1)
        if not len(left):
            break
        shape, owner = shape.take(left), owner[left]
        by = hider[first[owner] + turn]
        hiding = [*(tuple(t[by] for t in line) for line in lines), _nearer(pieces, name, by, owner)]
        shape, kept = _subtract(shape, hiding)
        owner = owner[kept]
    shapes, owners = zip(*done, strict=True)
    return Polygons.join(list(shapes)), torch.cat(owners)


def _nearer(pieces: Pieces, name: Tensor, one: Tensor, other: Tensor) -> Line:
    """The line on whose inner side pieces are nearer than others; where both are equally near the lower ids are."""
    c, a, b = pieces.plane[:, one] - pieces.plane[:, other]
    scale = torch.sqrt(a * a + b * b)
    even = scale == 0
    lower = torch.where(name[one] < name[other], 1.0, -1.0)
    scale = torch.where(even, 1.0, scale)
    return a / scale, b / scale, torch.where(even & (c == 0), lower, c / scale)


def _subtract(shape: Polygons, hiding: list[Line]) -> tuple[Polygons, Int64[Tensor, " M"]]:
    """What of polygons lies outside of a convex area each, given by its sides; and which polygon each part is of."""
    meet = torch.stack([shape.reaches_inside(line) for line in hiding]).all(0)
    apart, own = (~meet).nonzero().view(-1), meet.nonzero().view(-1)
    shapes, owners, rest = [shape.take(apart)], [apart], shape.take(own)
    for line in hiding:
        a, b, c = (t.index_select(0, own) for t in line)
        outside = rest.cut((-a, -b, -c))
        some = (outside.measure()[0] > NOTHING * 1e-6).nonzero().view(-1)
        shapes.append(outside.take(some))
        owners.append(own.index_select(0, some))
        rest = rest.cut((a, b, c))
    return Polygons.join(shapes), torch.cat(owners)


def _measured(pieces: Pieces, shape: Polygons, owner: Tensor, ids: Tensor, width: int) -> Fragments:
    """Area and centroid of what is seen of each piece."""
    area, across, down = (
        torch.zeros(len(pieces.place), dtype=torch.float64, device=owner.device).index_add_(0, owner, t)
        for t in shape.measure()
    )
    some = (area > NOTHING).nonzero().view(-1)
    place, name = pieces.place.index_select(0, some), ids.index_select(0, pieces.owner.index_select(0, some))
    area, across, down = (t.index_select(0, some) for t in (area, across, down))
    column, row = place % width, torch.div(place, width, rounding_mode="floor")
    center = torch.stack([(across / area).clamp(0, 1) + column, (down / area).clamp(0, 1) + row])
    order = torch.argsort(name, stable=True)
    order = order[torch.argsort(place[order], stable=True)]
    return place[order], name[order], area[order], center[:, order]
