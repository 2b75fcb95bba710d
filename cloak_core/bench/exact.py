"""Which area of each triangle is seen in each pixel, by clipping in float64: no samples, no resolution.

Every triangle is clipped against every pixel that it touches. In a pixel whose pieces add up to its whole area and to
its first moments, to nine digits, nothing overlaps. In the others, what each nearer triangle hides is cut off: the part
of a piece inside the other triangle where the other is nearer is convex, so everything stays a list of convex polygons.
Triangles that pierce each other are cut along their line.

Only the snapped vertices are shared with the rasterizer.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from cloak_core.bench.polygons import Polygons, cut
from cloak_core.render.visibility.clipping import clip
from cloak_core.render.visibility.projection import GRID, Screen

_CHUNK = 1 << 17
_WHOLE = 1e-9
_TOUCH = 1e-12
"""Pixels, or shares of the near plane's nearness, by which polygons must overlap to count as overlapping."""
MAX_PAIRS = 1 << 26
"""Overlapping pairs beyond which this is out of reach."""


class OutOfReach(Exception):
    """Too many triangles overlap each other."""


@dataclass(frozen=True)
class Flat:
    """N triangles on the screen, in pixels, corner by corner."""

    ids: Int64[Tensor, " N"]
    x: Float64[Tensor, "3 N"]
    y: Float64[Tensor, "3 N"]
    nearness: Float64[Tensor, "3 N"]


@dataclass(frozen=True)
class Seen:
    """What is seen, as N convex parts of triangles; several may belong to one triangle in one pixel."""

    pixel: Int64[Tensor, " N"]
    """Flat, y * W + x."""
    triangle: Int64[Tensor, " N"]
    area: Float64[Tensor, " N"]
    """Share of the pixel."""
    shape: Polygons
    """Pixels, counted from the pixel's top left corner."""


@dataclass(frozen=True)
class _Pieces:
    """P overlaps of a triangle with a pixel. Polygons are counted from the pixel's corner."""

    pixel: Int64[Tensor, " P"]
    owner: Int64[Tensor, " P"]
    shape: Polygons

    def take(self, index: Tensor) -> _Pieces:
        return _Pieces(self.pixel[index], self.owner[index], self.shape.take(index))


def seen_areas(screen: Screen, triangles: Int64[Tensor, "3 T"], cull: bool) -> Seen:
    """All that is seen of one view on the CPU. Raises `OutOfReach` beyond `MAX_PAIRS` overlapping pairs.

    triangles, cull: as for `render.visibility.rasterizer.rasterize`.
    """
    flat = _flat(screen, triangles, cull)
    pieces = _pieces(flat, screen.width, screen.height)
    measures = pieces.shape.measure()
    doubtful = torch.zeros(len(pieces.pixel), dtype=torch.bool)
    for measure, whole in zip(measures, (1.0, 0.5, 0.5), strict=True):
        total = torch.zeros(screen.width * screen.height, dtype=torch.float64).index_add_(0, pieces.pixel, measure)
        doubtful |= (total[pieces.pixel] - whole).abs() > _WHOLE
    clear, some = ((~doubtful).nonzero().view(-1), doubtful.nonzero().view(-1))
    shape, owner = pieces.shape.take(clear), clear
    if len(some):
        left, kept = _uncovered(pieces.take(some), flat, screen.width)
        shape, owner = Polygons.join([shape, left]), torch.cat([clear, some[kept]])
    area = shape.measure()[0]
    keep = (area > _TOUCH).nonzero().view(-1)
    owner = owner[keep]
    return Seen(pieces.pixel[owner], flat.ids[pieces.owner[owner]], area[keep], shape.take(keep))


def _flat(screen: Screen, triangles: Tensor, cull: bool) -> Flat:
    ids = torch.arange(triangles.shape[1])
    x, y, nearness = (t[0][triangles].double() for t in (screen.x, screen.y, screen.nearness))
    if screen.safe is not None:
        safe = screen.safe[0][triangles].all(0)
        corners = torch.stack([axis[0][triangles[:, ~safe]] for axis in screen.view], 1)
        one = torch.ones(corners.shape[-1], dtype=torch.float64)
        cut_off, owner = clip(corners, screen.focal[0] * one, screen.near[0] * one, screen.width, screen.height)
        parts = cut_off.x.double(), cut_off.y.double(), cut_off.nearness[cut_off.corner]
        x, y, nearness = (torch.cat([t[:, safe], p], 1) for t, p in zip((x, y, nearness), parts, strict=True))
        ids = torch.cat([ids[safe], ids[~safe][owner]])
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])  # its sign is exact within 1,000 pixels
    keep = area < 0 if cull else area != 0
    turned = torch.where(area[keep] > 0, 1, 2)  # all of them clockwise on a screen with y down
    order = torch.stack([torch.zeros_like(turned), turned, 3 - turned])
    x, y, nearness = (t[:, keep].gather(0, order) for t in (x, y, nearness))
    return Flat(ids[keep], x / GRID, y / GRID, nearness)


def _extent(t: Float64[Tensor, "3 N"], limit: int) -> tuple[Int64[Tensor, " N"], Int64[Tensor, " N"]]:
    """The first and the last pixel, along one axis of the image, that each triangle touches."""
    return t.amin(0).floor().long().clamp(min=0), (t.amax(0).ceil().long() - 1).clamp(max=limit - 1)


def _pieces(flat: Flat, width: int, height: int) -> _Pieces:
    (c0, c1), (r0, r1) = _extent(flat.x, width), _extent(flat.y, height)
    across, down = (c1 - c0 + 1).clamp(min=0), (r1 - r0 + 1).clamp(min=0)
    parts = []
    for start in range(0, len(flat.ids), _CHUNK // 4):
        own = slice(start, start + _CHUNK // 4)
        owner, offset = _repeated((across * down)[own])
        owner += start
        row, column = r0[owner] + offset // across[owner], c0[owner] + offset % across[owner]
        for box in (slice(i, i + _CHUNK) for i in range(0, len(owner), _CHUNK)):
            parts.append(_clipped(flat, owner[box], column[box], row[box], width))
    parts = parts or [_clipped(flat, *[torch.zeros(0, dtype=torch.int64)] * 3, width)]
    joined = _Pieces(*(torch.cat([getattr(p, k) for p in parts]) for k in ("pixel", "owner")),
                     Polygons.join([p.shape for p in parts]))  # fmt: skip
    return joined.take(torch.argsort(joined.pixel, stable=True))


def _clipped(flat: Flat, owner: Tensor, column: Tensor, row: Tensor, width: int) -> _Pieces:
    shape = Polygons(flat.x[:, owner] - column, flat.y[:, owner] - row, torch.full_like(owner, 3))
    for axis in "xy":
        for side in (lambda t: t, lambda t: 1 - t):
            shape = cut(shape, side(getattr(shape, axis)))
    keep = (shape.measure()[0] > _TOUCH).nonzero().view(-1)
    return _Pieces((row * width + column)[keep], owner[keep], shape.take(keep))


def _repeated(counts: Int64[Tensor, " N"]) -> tuple[Tensor, Tensor]:
    """Each index i counts[i] times, with its offset 0 .. counts[i] - 1."""
    owner = torch.repeat_interleave(counts)
    return owner, torch.arange(len(owner)) - (counts.cumsum(0) - counts)[owner]


@dataclass(frozen=True)
class _Planes:
    """For P pieces: what is inside the triangle, as three half planes, and its nearness; all linear, from the pixel's
    corner: value = across * x + down * y + start."""

    edges: tuple[Float64[Tensor, "3 P"], Float64[Tensor, "3 P"], Float64[Tensor, "3 P"]]
    """Pixels to the inside of each edge."""
    nearness: tuple[Float64[Tensor, " P"], Float64[Tensor, " P"], Float64[Tensor, " P"]]


def _planes(pieces: _Pieces, flat: Flat, width: int) -> _Planes:
    x = flat.x[:, pieces.owner] - pieces.pixel % width
    y = flat.y[:, pieces.owner] - torch.div(pieces.pixel, width, rounding_mode="floor")
    dx, dy = x.roll(-1, 0) - x, y.roll(-1, 0) - y
    length = torch.hypot(dx, dy)
    across, down = -dy / length, dx / length
    n = flat.nearness[:, pieces.owner]
    d1x, d2x, d1y, d2y, d1n, d2n = (t[i] - t[0] for t in (x, y, n) for i in (1, 2))
    area = d1x * d2y - d2x * d1y
    gx, gy = (d1n * d2y - d2n * d1y) / area, (d2n * d1x - d1n * d2x) / area
    return _Planes((across, down, -(across * x + down * y)), (gx, gy, n[0] - gx * x[0] - gy * y[0]))


def _uncovered(pieces: _Pieces, flat: Flat, width: int) -> tuple[Polygons, Int64[Tensor, " N"]]:
    """What is seen of pieces that may hide each other, and which piece each part belongs to."""
    planes = _planes(pieces, flat, width)
    first, count, hider = _hiders(pieces, planes, flat)
    shape, owner = pieces.shape, torch.arange(len(pieces.pixel))
    done_shapes, done_owners = [], []
    for turn in range(int(count.max()) + 1):
        finished = count[owner] <= turn
        done_shapes.append(shape.take(finished.nonzero().view(-1)))
        done_owners.append(owner[finished])
        left = (~finished).nonzero().view(-1)
        if not len(left):
            break
        shape, owner = shape.take(left), owner[left]
        shape, owner = _subtract(shape, owner, hider[first[owner] + turn], planes, flat.ids[pieces.owner])
    return Polygons.join(done_shapes), torch.cat(done_owners)


def _hiders(pieces: _Pieces, planes: _Planes, flat: Flat) -> tuple[Tensor, Tensor, Tensor]:
    """Which pieces may hide which: for each its first entry in a list, how many there are, and the list."""
    _, group, size = torch.unique_consecutive(pieces.pixel, return_inverse=True, return_counts=True)
    rivals = size[group]
    if int(rivals.sum()) > MAX_PAIRS:
        raise OutOfReach(f"{int(rivals.sum())} pairs of triangles in one pixel")
    begin = (size.cumsum(0) - size)[group]
    used, far = pieces.shape.used(), torch.inf
    spans = [
        (torch.where(used, t, far).amin(0), torch.where(used, t, -far).amax(0))
        for t in (pieces.shape.x, pieces.shape.y, _at(planes.nearness, pieces.shape))
    ]
    found, count = [], torch.zeros_like(rivals)
    for start in range(0, len(rivals), step := 1 << 15):
        mine, offset = _repeated(rivals[start : start + step])
        mine += start
        other = begin[mine] + offset
        meet = (mine != other) & (spans[2][1][other] > spans[2][0][mine] - _TOUCH)
        for low, high in spans[:2]:
            meet &= (high[other] > low[mine] + _TOUCH) & (low[other] < high[mine] - _TOUCH)
        mine, other = mine[meet], other[meet]
        found.append(other)
        count.index_add_(0, mine, torch.ones_like(mine))
    return count.cumsum(0) - count, count, torch.cat(found)


def _at(line: tuple[Tensor, Tensor, Tensor], shape: Polygons) -> Float64[Tensor, "C N"]:
    across, down, start = line
    return across * shape.x + down * shape.y + start


def _subtract(
    shape: Polygons, owner: Tensor, hider: Tensor, planes: _Planes, ids: Tensor
) -> tuple[Polygons, Int64[Tensor, " M"]]:
    """What is left of polygons (parts of the pieces `owner`) when what one other piece hides of each is taken away."""
    edges = [tuple(t[i][hider] for t in planes.edges) for i in range(3)]
    nearer = tuple(t[hider] - t[owner] for t in planes.nearness)
    # Where both are equally near, the lower triangle hides the other.
    bias = torch.where(ids[hider] < ids[owner], _TOUCH, -_TOUCH)
    lines = [*edges, (*nearer[:2], nearer[2] + bias)]
    used = shape.used()
    reached = torch.stack([torch.where(used, _at(line, shape), -torch.inf).amax(0) for line in lines])
    limits = torch.tensor([_TOUCH, _TOUCH, _TOUCH, 0.0], dtype=torch.float64)
    meet: Bool[Tensor, " N"] = (reached > limits.unsqueeze(1)).all(0)
    apart, index = (~meet).nonzero().view(-1), meet.nonzero().view(-1)
    shapes, owners = [shape.take(apart)], [owner[apart]]
    rest, own = shape.take(index), owner[index]
    for line in lines:
        value = _at(tuple(t[index] for t in line), rest)
        outside = cut(rest, -value)
        some = (outside.measure()[0] > _TOUCH**1.5).nonzero().view(-1)
        shapes.append(outside.take(some))
        owners.append(own[some])
        rest = cut(rest, value)
    return Polygons.join(shapes), torch.cat(owners)
