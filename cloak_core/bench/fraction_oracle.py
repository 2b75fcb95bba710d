"""Visible areas in exact fractions: the reference of every area renderer, which shares only its conventions.

Every triangle is cut to every pixel (Sutherland-Hodgman), then the part that each other triangle hides is cut away,
polygon by polygon. The greater inverse depth is nearer, of equal ones the lower index. Slow and obviously right.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction

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
            points, near = points[::-1], near[::-1]
        if area(points) != 0:
            faces.append((name, points, sides(points), plane(points, near)))
    shares = {}
    for pixel in range(width * height):
        column, row = pixel % width, pixel // width
        corners = [(column, row), (column + 1, row), (column + 1, row + 1), (column, row + 1)]
        square = sides([(Fraction(a), Fraction(b)) for a, b in corners])
        here = [face for face in faces if near_pixel(face[1], column, row) and area(clip(face[1], square)) > 0]
        for face in here:
            left = [clip(face[1], square)]
            for other in here:
                left = [part for whole in left for part in without(whole, hiding(face, other))]
            share = sum(map(area, left))
            if share > 0:
                shares[pixel, face[0]] = share
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
    if lines is None or area(clip(polygon, lines)) == 0:
        return [polygon]
    parts = []
    for a, b, c in lines:
        outside = clip(polygon, [(-a, -b, -c)])
        if area(outside) > 0:
            parts.append(outside)
        polygon = clip(polygon, [(a, b, c)])
    return parts


def clip(polygon: list[Point], lines: list[Line]) -> list[Point]:
    """Clip a convex polygon to the inside of lines."""
    for a, b, c in lines:
        kept = []
        for i, (x0, y0) in enumerate(polygon):
            x1, y1 = polygon[(i + 1) % len(polygon)]
            here, there = a * x0 + b * y0 + c, a * x1 + b * y1 + c
            if here >= 0:
                kept.append((x0, y0))
            if here * there < 0:
                share = here / (here - there)
                kept.append((x0 + share * (x1 - x0), y0 + share * (y1 - y0)))
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
