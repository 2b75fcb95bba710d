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
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from cloak_core.render.visibility.flat import FlatTriangles
from cloak_core.render.visibility.polygons import Line, distances, inner_part, join, measure
from cloak_core.render.visibility.projection import GRID, Window
from cloak_core.render.visibility.samples import Triangles, canonical, chunk_size, expand

NOTHING = 1e-9
"""Share of a pixel below which a piece is dropped."""
DEPTH_STEPS = 1 << 42
"""Steps of nearness that are told apart."""
_MARGIN = 64.0
"""Steps by which a piece must lie behind a triangle that fills its pixel to be dropped at once."""

Found = tuple[Int64[Tensor, " N"], Int64[Tensor, " N"], Float[Tensor, " N"], Float64[Tensor, "2 N"]]
"""Pixel, triangle, share of the pixel, and the centroid of what is seen, pixels; sorted by pixel and triangle."""


class CrowdedPixels(UserWarning):
    """Pixels in which so many pieces are seen that they were given up: what they show is not exact."""

    def __init__(self, pixels: int) -> None:
        super().__init__(f"{pixels} pixels show too many pieces to be exact")
        self.pixels = pixels


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
    """Depth in steps: at the pixel's corner, change over a pixel right, change over one down."""

    def take(self, index: Int64[Tensor, " K"]) -> Pieces:
        return Pieces(*(t.index_select(-1, index) for t in (self.place, self.owner, self.shape, self.plane)))

    def join(self, other: Pieces) -> Pieces:
        place, owner, plane = (
            torch.cat([getattr(self, name), getattr(other, name)], -1) for name in ("place", "owner", "plane")
        )
        return Pieces(place, owner, join([self.shape, other.shape]), plane)

    def depth_range(self) -> tuple[Float64[Tensor, " P"], Float64[Tensor, " P"]]:
        depth = self.plane[0] + (self.plane[1:] * self.shape).sum(1)
        return depth.amin(0), depth.amax(0)


def seen_areas(flat: FlatTriangles, window: Window, width: int) -> Iterator[Found]:
    """What is seen of a view in a window of an image so many pixels wide, from top to bottom, band by band of rows:
    memory is that of one."""
    triangles = canonical(flat)
    box = torch.stack([*_touched(triangles.x, window.x0, window.x1), *_touched(triangles.y, window.y0, window.y1)])
    some = (torch.minimum(box[1] - box[0], box[3] - box[2]) >= 0).nonzero().view(-1)
    triangles, box = triangles.take(some), box.index_select(1, some)
    for top, bottom in _bands(box, window, chunk_size(box.device)):
        pieces = _pieces(triangles, box, top, bottom, width)
        names = triangles.ids.index_select(0, pieces.owner)
        order = torch.argsort(names, stable=True)
        pieces = pieces.take(order[torch.argsort(pieces.place[order], stable=True)])
        yield _measured(pieces, *_uncovered(pieces, triangles, width), triangles, width)


def _touched(position: Int64[Tensor, "3 N"], first: int, stop: int) -> tuple[Tensor, Tensor]:
    """First and last pixel that triangles touch along one axis."""
    low, high = position.amin(0) // GRID, (position.amax(0) - 1) // GRID
    return low.clamp(min=first), high.clamp(max=stop - 1)


def _bands(box: Int64[Tensor, "4 N"], window: Window, most: int) -> Iterator[tuple[int, int]]:
    """Rows from .. to (exclusive), each with at most so many pairs of triangle and pixel, or a single row."""
    left, right, top, bottom = box
    load = torch.zeros(window.y1 - window.y0 + 1, dtype=torch.int64, device=box.device)
    load.index_add_(0, top - window.y0, right - left + 1).index_add_(0, bottom + 1 - window.y0, left - right - 1)
    start, held = window.y0, 0
    for row, pairs in enumerate(load.cumsum(0)[:-1].tolist(), window.y0):
        if held and held + pairs > most:
            yield start, row
            start, held = row, 0
        held += pairs
    if held:
        yield start, window.y1


def _pieces(triangles: Triangles, box: Int64[Tensor, "4 N"], top: int, bottom: int, width: int) -> Pieces:
    """All pieces in a band of rows, but those behind a triangle that fills their pixel."""
    c0, c1, r0, r1 = box
    first, last = r0.clamp(min=top), r1.clamp(max=bottom - 1)
    pieces = None
    front = torch.full(((bottom - top) * width,), -torch.inf, dtype=torch.float64, device=box.device)
    for owner, down in expand((last - first + 1).clamp(min=0)):
        for pair, across in expand((c1 - c0 + 1).index_select(0, owner)):
            own = owner.index_select(0, pair)
            column, row = c0.index_select(0, own) + across, (first.index_select(0, own) + down.index_select(0, pair))
            new = _cut_to_pixels(triangles, own, column, row, width)
            full = torch.where(measure(new.shape)[0] > 1 - 1e-12, new.depth_range()[0], -torch.inf)
            front.scatter_reduce_(0, new.place - top * width, full, "amax")
            pieces = new if pieces is None else pieces.join(new)
            ahead = pieces.depth_range()[1] + _MARGIN >= front.index_select(0, pieces.place - top * width)
            pieces = pieces.take(ahead.nonzero().view(-1))
    return pieces


def _cut_to_pixels(triangles: Triangles, own: Tensor, column: Tensor, row: Tensor, width: int) -> Pieces:
    """The pieces of triangles in pixels, those without area left out."""
    left, top = column * GRID, row * GRID
    shape = _from_corner(triangles, own, left, top)
    one, zero = torch.ones_like(shape[0, 0]), torch.zeros_like(shape[0, 0])
    for side in ((one, zero, zero), (-one, zero, one), (zero, one, zero), (zero, -one, one)):
        shape = inner_part(shape, side)
    start, right, down = (
        torch.round(triangles.nearness_at(own, left + i * GRID, top + j * GRID) * DEPTH_STEPS)
        for i, j in ((0, 0), (1, 0), (0, 1))
    )
    pieces = Pieces(row * width + column, own, shape, torch.stack([start, right - start, down - start]))
    return pieces.take((measure(shape)[0] > NOTHING).nonzero().view(-1))


def _from_corner(triangles: Triangles, own: Tensor, left: Tensor, top: Tensor) -> Float64[Tensor, "3 2 P"]:
    """Triangles' corners, pixels from the corner of one (grid units)."""
    at = lambda t, origin: (t.index_select(1, own) - origin).to(torch.float64) / GRID
    return torch.stack([at(triangles.x, left), at(triangles.y, top)], 1)


def _lines(pieces: Pieces, triangles: Triangles, width: int) -> list[Line]:
    """The three edges of each piece's triangle, from the pixel's corner."""
    left, top = pieces.place % width * GRID, torch.div(pieces.place, width, rounding_mode="floor") * GRID
    corners, lines = _from_corner(triangles, pieces.owner, left, top), []
    for (x0, y0), (x1, y1) in ((corners[0], corners[1]), (corners[1], corners[2]), (corners[2], corners[0])):
        dx, dy = x1 - x0, y1 - y0
        scale = 1 / torch.sqrt(dx * dx + dy * dy)
        a, b = -dy * scale, dx * scale
        lines.append((a, b, -(a * (x0 + x1) + b * (y0 + y1)) * 0.5))  # from the middle, which a neighbour shares
    return lines


def _hiders(pieces: Pieces) -> tuple[Tensor, Tensor, Tensor]:
    """Which pieces, sorted by place, may hide which: for each its first entry in a list, how many there are, and the
    list."""
    _, group, size = torch.unique_consecutive(pieces.place, return_inverse=True, return_counts=True)
    begin, rivals = (size.cumsum(0) - size)[group], size[group]
    (least, most), low, high = pieces.depth_range(), pieces.shape.amin(0), pieces.shape.amax(0)
    found, count = [begin[:0]], torch.zeros_like(rivals)
    for mine, offset in expand(rivals):
        other = begin[mine] + offset
        meet = (mine != other) & (most[other] >= least[mine] - 1)
        meet &= ((high[:, other] > low[:, mine]) & (low[:, other] < high[:, mine])).all(0)
        found.append(other[meet])
        count += torch.bincount(mine[meet], minlength=len(count))
    return count.cumsum(0) - count, count, torch.cat(found)


def _uncovered(
    pieces: Pieces, triangles: Triangles, width: int
) -> tuple[Float64[Tensor, "C 2 N"], Int64[Tensor, " N"]]:
    """What is seen of pieces, sorted by place: convex parts, and which piece each part belongs to.

    In each turn every piece meets one more of those that may hide it.
    """
    lines, name = _lines(pieces, triangles, width), triangles.ids.index_select(0, pieces.owner)
    first, count, hider = _hiders(pieces)
    shape, owner, done = pieces.shape, torch.arange(len(name), device=name.device), []
    for turn in itertools.count():
        finished = count[owner] <= turn
        done.append((shape[..., finished], owner[finished]))
        shape, owner = shape[..., ~finished], owner[~finished]
        if not len(owner):
            break
        by = hider[first[owner] + turn]
        hiding = [*(tuple(t[by] for t in line) for line in lines), _nearer(pieces, name, by, owner)]
        shape, kept = _subtract(shape, hiding)
        owner = owner[kept]
    shapes, owners = zip(*done, strict=True)
    return join(list(shapes)), torch.cat(owners)


def _nearer(pieces: Pieces, name: Tensor, one: Tensor, other: Tensor) -> Line:
    """The line on whose inner side pieces are nearer than others; where both are equally near the lower ids are."""
    c, a, b = pieces.plane[:, one] - pieces.plane[:, other]
    scale = torch.sqrt(a * a + b * b)
    even = scale == 0
    lower = torch.where(name[one] < name[other], 1.0, -1.0)
    scale = torch.where(even, 1.0, scale)
    return a / scale, b / scale, torch.where(even & (c == 0), lower, c / scale)


def _subtract(
    shape: Float64[Tensor, "C 2 N"], hiding: list[Line]
) -> tuple[Float64[Tensor, "K 2 M"], Int64[Tensor, " M"]]:
    """What of polygons lies outside of a convex area each, given by its sides; and which polygon each part is of."""
    meet = torch.stack([(distances(shape, line) > 0).any(0) for line in hiding]).all(0)
    apart, own = (~meet).nonzero().view(-1), meet.nonzero().view(-1)
    shapes, owners, rest = [shape.index_select(-1, apart)], [apart], shape.index_select(-1, own)
    for line in hiding:
        a, b, c = (t.index_select(0, own) for t in line)
        outside = inner_part(rest, (-a, -b, -c))
        some = (measure(outside)[0] > NOTHING * 1e-6).nonzero().view(-1)
        shapes.append(outside.index_select(-1, some))
        owners.append(own.index_select(0, some))
        rest = inner_part(rest, (a, b, c))
    return join(shapes), torch.cat(owners)


def _measured(pieces: Pieces, shape: Tensor, owner: Tensor, triangles: Triangles, width: int) -> Found:
    """Area and centroid of what is seen of each piece."""
    total = torch.zeros(3, len(pieces.place), dtype=torch.float64, device=owner.device)
    total.index_add_(1, owner, measure(shape))
    some = (total[0] > NOTHING).nonzero().view(-1)
    place, owner, (area, *moments) = pieces.place[some], pieces.owner[some], total[:, some]
    corner = torch.stack([place % width, torch.div(place, width, rounding_mode="floor")])
    return place, triangles.ids[owner], area, (torch.stack(moments) / area).clamp(0, 1) + corner
