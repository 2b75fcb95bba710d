"""The rasterizer's plain twins: samples in integers, visible areas in fractions; nothing skipped and nothing clever.

Slow and obviously right; the tests and `cloak bench stability` hold the rasterizer against it. Edge functions of
snapped coordinates stay below 2^62, so int64 is exact. The depth of a covered sample is worked out in Python floats,
one operation after the other, by the formula that `visibility.screen` documents.

`visible_shares` has areas: every triangle is cut to every pixel (Sutherland-Hodgman), then the part that each other
triangle hides is cut away, polygon by polygon. The greater inverse depth is nearer, of equal ones the lower index.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import torch
from torch import Tensor

from cloak_core.core.view import Screen
from cloak_core.core.visibility.projection import clip
from cloak_core.core.visibility.screen import DEPTH_BITS, GRID


@dataclass(frozen=True)
class Corner:
    """A snapped corner: x and y in grid units, inverse_depth as the rasterizer sees it."""

    x: int
    y: int
    inverse_depth: float


@dataclass
class Piece:
    """A triangle, or the part of one that clipping left, in one view."""

    view: int
    triangle: int
    corners: tuple[Corner, Corner, Corner]

    @property
    def area(self) -> int:
        """Twice the area, positive where clockwise on a screen with y down."""
        a, b, c = self.corners
        return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)


def pieces(screen: Screen, triangles: Tensor) -> list[Piece]:
    """List all triangles [3, T] of all views, cut where they must be."""
    x, y, inverse_depth = (t.tolist() for t in (screen.x, screen.y, screen.inverse_depth))
    safe = screen.in_guard_band.tolist() if screen.in_guard_band is not None else None
    result = []
    for view in range(len(x)):
        for triangle, vertices in enumerate(triangles.T.tolist()):
            if safe is None or all(safe[view][v] for v in vertices):
                corners = tuple(Corner(x[view][v], y[view][v], inverse_depth[view][v]) for v in vertices)
                result.append(Piece(view, triangle, corners))
                continue
            view_space = screen.view[view][:, vertices].T.unsqueeze(-1)
            *parts, _ = clip(view_space, screen.focal[view], screen.near[view], screen.width, screen.height)
            for part in zip(*(t.T.tolist() for t in parts), strict=True):
                result.append(Piece(view, triangle, tuple(Corner(*c) for c in zip(*part, strict=True))))
    return result


def covered(piece: Piece, sample_x: np.ndarray, sample_y: np.ndarray) -> np.ndarray:
    """Mark the samples, at these snapped positions (int64), that the piece covers under the top-left rule."""
    if piece.area == 0:
        return np.zeros(sample_x.shape, bool)
    a, b, c = piece.corners if piece.area > 0 else piece.corners[::-1]
    inside = np.ones(sample_x.shape, bool)
    for start, end in ((a, b), (b, c), (c, a)):
        dx, dy = end.x - start.x, end.y - start.y
        edge = dx * (sample_y - start.y) - dy * (sample_x - start.x)
        # Clockwise with y down: a left edge goes up, a top edge goes right.
        inside &= (edge >= 0) if dy < 0 or (dy == 0 and dx > 0) else (edge > 0)
    return inside


def depth(piece: Piece, x: int, y: int) -> int:
    """Compute the depth number of a covered sample, as documented: smaller is nearer."""
    corners = piece.corners if piece.area > 0 else piece.corners[::-1]
    first = min(range(3), key=lambda i: (corners[i].y, -corners[i].x))
    c0, c1, c2 = (corners[(first + i) % 3] for i in range(3))
    area = float(abs(piece.area))
    e1 = (c2.y - c0.y) * (x - c0.x) - (c2.x - c0.x) * (y - c0.y)
    e2 = (c1.x - c0.x) * (y - c0.y) - (c1.y - c0.y) * (x - c0.x)
    slope1, slope2 = (c1.inverse_depth - c0.inverse_depth) / area, (c2.inverse_depth - c0.inverse_depth) / area
    inverse_depth = (float(e1) * slope1 + float(e2) * slope2) + c0.inverse_depth
    limit = (1 << DEPTH_BITS) - 1
    return limit - min(max(int(inverse_depth * (1 << DEPTH_BITS)), 0), limit)


def sample_positions(width: int, height: int, grid: int) -> tuple[np.ndarray, np.ndarray]:
    """Snapped x and y [H, W, S] of the samples, S = grid * grid row by row."""
    step = GRID // grid
    rows, columns = (np.arange(count * grid, dtype=np.int64) * step + step // 2 for count in (height, width))
    y, x = (
        axis.reshape(height, grid, width, grid).transpose(0, 2, 1, 3).reshape(height, width, grid * grid)
        for axis in np.meshgrid(rows, columns, indexing="ij")
    )
    return x, y


def twin(screen: Screen, triangles: Tensor, grid: int = 1, cull: Tensor | None = None) -> np.ndarray:
    """Compute the triangle ids int32 [B, H, W, S] that `rasterize(...).triangles()` must give; -1 = none."""
    sample_x, sample_y = sample_positions(screen.width, screen.height, grid)
    ids = np.full((len(screen.x), *sample_x.shape), -1, np.int32)
    best = np.full(ids.shape, np.iinfo(np.int64).max)
    for piece in pieces(screen, triangles):
        if cull is not None and bool(cull[piece.view]) and piece.area > 0:
            continue
        for index in np.argwhere(covered(piece, sample_x, sample_y)):
            place = (piece.view, *index)
            number = depth(piece, int(sample_x[tuple(index)]), int(sample_y[tuple(index)]))
            if (number, piece.triangle) < (best[place], ids[place]) or ids[place] < 0:
                best[place] = number
                ids[place] = piece.triangle
    return ids


def hits(screen: Screen, triangles: Tensor, grid: int = 1, front_only: bool = False) -> np.ndarray:
    """Count the triangles that cover each sample, int64 [B, H, W, S]."""
    sample_x, sample_y = sample_positions(screen.width, screen.height, grid)
    count = np.zeros((len(screen.x), *sample_x.shape), np.int64)
    for piece in pieces(screen, triangles):
        if not (front_only and piece.area > 0):
            count[piece.view] += covered(piece, sample_x, sample_y)
    return count


def screen_of(x: np.ndarray, y: np.ndarray, inverse_depth: np.ndarray, width: int, height: int) -> Screen:
    """Make a one-view screen from snapped integer coordinates [V] directly, for cases made by hand."""

    def row(values: np.ndarray, dtype: torch.dtype) -> Tensor:
        return torch.as_tensor(np.asarray(values)).to(dtype).reshape(1, -1)

    z = 1 / row(inverse_depth, torch.float64)
    focal = torch.full((1, 1), float(height), dtype=torch.float64)
    snapped_x, snapped_y = row(x, torch.int32), row(y, torch.int32)
    rays = (snapped_x / GRID - width / 2) / focal, (height / 2 - snapped_y / GRID) / focal
    view = torch.stack([rays[0] * z, rays[1] * z, z], 1)
    ends = [int(e) for t in (snapped_x, snapped_y) for e in (torch.aminmax(t) if t.numel() else (0, 0))]
    inverse_depth = row(inverse_depth, torch.float64)
    near_plane = torch.ones_like(focal)
    return Screen(width, height, view, snapped_x, snapped_y, inverse_depth, None, tuple(ends), focal, near_plane)


Point = tuple[Fraction, Fraction]
Line = tuple[Fraction, Fraction, Fraction]
"""a x + b y + c, not negative inside."""


def visible_shares(
    x: Iterable, y: Iterable, inverse_depth: Iterable, triangles: Iterable, size: tuple[int, int], unit: int, cull: bool
) -> dict[tuple[int, int], Fraction]:
    """Compute the exact share of each pixel by (pixel, triangle).

    x, y: whole numbers, `unit` to a pixel; inverse_depth: floats; size: width and height in pixels; cull: drop
    triangles that show their back.
    """
    width, height = size
    faces = []
    for name, corners in enumerate(triangles):
        points = [(Fraction(int(x[i]), unit), Fraction(int(y[i]), unit)) for i in corners]
        near = [Fraction(float(inverse_depth[i])) for i in corners]
        if cull and area(points) > 0:
            continue
        if area(points) < 0:
            points = points[::-1]
            near = near[::-1]
        if area(points) != 0:
            faces.append((name, points, sides(points), plane(points, near)))
    shares = {}
    for pixel in range(width * height):
        column, row = pixel % width, pixel // width
        corners = [(column, row), (column + 1, row), (column + 1, row + 1), (column, row + 1)]
        square = sides([(Fraction(a), Fraction(b)) for a, b in corners])
        here = [face for face in faces if near_pixel(face[1], column, row) and area(cut(face[1], square)) > 0]
        for face in here:
            left = [cut(face[1], square)]
            for other in here:
                left = [part for whole in left for part in without(whole, hiding(face, other))]
            visible = sum(map(area, left))
            if visible > 0:
                shares[pixel, face[0]] = visible
    return shares


def near_pixel(points: list[Point], column: int, row: int) -> bool:
    """Test whether the bounding box of a polygon meets a pixel."""
    xs, ys = zip(*points, strict=True)
    return min(xs) < column + 1 and max(xs) > column and min(ys) < row + 1 and max(ys) > row


def hiding(face: tuple, other: tuple) -> list[Line] | None:
    """Find the convex area in which another triangle hides this one; None: nowhere."""
    (name, _, _, own), (other_name, _, outline, nearer) = face, other
    difference = tuple(b - a for a, b in zip(own, nearer, strict=True))
    if name == other_name:
        return None
    if difference == (0, 0, 0):
        return outline if other_name < name else None
    return [*outline, difference]


def without(polygon: list[Point], lines: list[Line] | None) -> list[list[Point]]:
    """Convex parts of a convex polygon outside of an area."""
    if lines is None or area(cut(polygon, lines)) == 0:
        return [polygon]
    parts = []
    for a, b, c in lines:
        outside = cut(polygon, [(-a, -b, -c)])
        if area(outside) > 0:
            parts.append(outside)
        polygon = cut(polygon, [(a, b, c)])
    return parts


def cut(polygon: list[Point], lines: list[Line]) -> list[Point]:
    """Clip a convex polygon to the inside of lines."""
    for a, b, c in lines:
        kept = []
        for i, (x0, y0) in enumerate(polygon):
            x1, y1 = polygon[(i + 1) % len(polygon)]
            here, there = a * x0 + b * y0 + c, a * x1 + b * y1 + c
            if here >= 0:
                kept.append((x0, y0))
            if here * there < 0:
                fraction = here / (here - there)
                kept.append((x0 + fraction * (x1 - x0), y0 + fraction * (y1 - y0)))
        polygon = kept
    return polygon


def sides(points: list[Point]) -> list[Line]:
    """Compute the lines of the sides of a polygon that runs clockwise on a screen with y down."""
    lines = []
    for i, (x0, y0) in enumerate(points):
        x1, y1 = points[(i + 1) % len(points)]
        lines.append((y0 - y1, x1 - x0, x0 * y1 - x1 * y0))
    return lines


def plane(points: list[Point], near: list[Fraction]) -> Line:
    """Compute the inverse depth of a triangle as a linear function."""
    (x0, y0), (x1, y1), (x2, y2) = points
    twice = 2 * area(points)
    a = ((near[1] - near[0]) * (y2 - y0) - (near[2] - near[0]) * (y1 - y0)) / twice
    b = ((near[2] - near[0]) * (x1 - x0) - (near[1] - near[0]) * (x2 - x0)) / twice
    return a, b, near[0] - a * x0 - b * y0


def area(points: list[Point]) -> Fraction:
    """Compute the signed area, positive where clockwise on a screen with y down."""
    pairs = zip(points, points[1:] + points[:1], strict=True)
    return sum((x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in pairs), Fraction(0)) / 2
