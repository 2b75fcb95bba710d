"""Polygons and how they fall into triangles.

Polygons are stored as Blender stores them: `loop_total` [F] counts the corners of each, `loop_vertices` [C] holds their
vertices one polygon after the other, C corners in all.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Integer

from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError

MAX_CORNERS = 1000
"""More corners than any modelled polygon has; ear clipping takes their square."""

Corners = Integer[np.ndarray, " corners"]


def loop_starts(loop_total: Integer[np.ndarray, " faces"]) -> Integer[np.ndarray, " faces"]:
    """Find the index of each polygon's first corner."""
    return np.cumsum(loop_total, dtype=np.int64) - loop_total


def next_corner(loop_total: Integer[np.ndarray, " faces"]) -> Corners:
    """Find the corner that follows every corner in its polygon (the last one's is the first)."""
    following = np.arange(1, int(loop_total.sum(dtype=np.int64)) + 1, dtype=np.int64)
    starts = loop_starts(loop_total)
    following[starts + loop_total - 1] = starts
    return following


def polygon_loops(bodies: Bodies) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """List the polygons as (loop_total [N], loop_vertices [C], face [N]); a scene without loops has triangles.

    `face` is the polygon id that each of the N loops belongs to.
    """
    if bodies.loop_total is not None and bodies.loop_vertices is not None:
        return bodies.loop_total, bodies.loop_vertices, np.arange(bodies.face_count, dtype=np.int64)
    assert bodies.triangle_face is not None
    total = np.full(bodies.triangle_count, 3, np.int32)
    return total, bodies.triangles.reshape(-1), bodies.triangle_face.astype(np.int64)


def per_corner(bodies: Bodies, values: Integer[np.ndarray, "triangles 3"]) -> Corners:
    """Find for every polygon corner [C] what `values` say of the triangles' corners there.

    A corner is named by its polygon and vertex; a vertex twice in one polygon takes its first corner's value.
    """
    loop_total, loop_vertices, face = polygon_loops(bodies)
    base = bodies.vertex_count
    wanted = np.repeat(face, loop_total) * base + loop_vertices
    known, first = np.unique(
        bodies.triangle_face.astype(np.int64)[:, None] * base + bodies.triangles, return_index=True
    )
    return values.reshape(-1)[first[np.searchsorted(known, wanted)]]


def triangulate(
    points: Float[np.ndarray, "vertices 3"], loop_total: Integer[np.ndarray, " faces"], loop_vertices: Corners
) -> tuple[Integer[np.ndarray, "triangles 3"], Integer[np.ndarray, " triangles"]]:
    """Split polygons into triangles, n - 2 for n corners, those of one polygon side by side and in polygon order.

    Returns corner indices [T, 3] (`loop_vertices[corners]` are the triangles, any other per-corner array follows alike)
    and each triangle's polygon [T]. Quads take the diagonal inside them, the shorter one where both are; larger
    polygons lose one ear after the other. Nothing fails on degenerate or self-crossing polygons.
    """
    if len(loop_total) and int(loop_total.max()) > MAX_CORNERS:
        face = int(loop_total.argmax())
        raise InputError(f"polygon {face} has {int(loop_total[face])} corners; at most {MAX_CORNERS} are read")
    points = points.astype(np.float64)
    starts = loop_starts(loop_total)
    count = np.asarray(loop_total, np.int64) - 2
    triangle_face = np.repeat(np.arange(len(loop_total)), count)
    first = np.cumsum(count) - count
    corners = np.zeros((len(triangle_face), 3), np.int64)
    threes = np.flatnonzero(loop_total == 3)
    corners[first[threes]] = starts[threes, None] + np.arange(3)
    fours = np.flatnonzero(loop_total == 4)
    split = split_quads(points[loop_vertices[starts[fours, None] + np.arange(4)]])
    corners[first[fours]] = starts[fours, None] + split[:, 0]
    corners[first[fours] + 1] = starts[fours, None] + split[:, 1]
    for face in np.flatnonzero(loop_total > 4):
        loop = np.arange(starts[face], starts[face] + loop_total[face])
        corners[first[face] : first[face] + count[face]] = loop[clip_ears(points[loop_vertices[loop]])]
    return corners, triangle_face


def split_quads(quads: Float[np.ndarray, "quads 4 3"]) -> Integer[np.ndarray, "quads 2 3"]:
    """Split each quad: the corner numbers of its two triangles."""
    ways = np.array([[[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]])
    diagonals = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    normal = np.cross(*diagonals)
    inside, length = [], []
    for way, diagonal in zip(ways, diagonals, strict=True):
        a, b, c = (quads[:, way[:, corner]] for corner in range(3))
        facing = (np.cross(b - a, c - a) * normal[:, None]).sum(axis=2)
        inside.append((facing > 0).all(axis=1))
        length.append((diagonal**2).sum(axis=1))
    second = np.where(inside[0] == inside[1], length[1] < length[0], inside[1])
    return ways[second.astype(int)]


def clip_ears(polygon: Float[np.ndarray, "corners 3"]) -> Integer[np.ndarray, "triangles 3"]:
    """Triangulate a polygon, concave or not, along its normal, by ear clipping: corner numbers of n - 2 triangles."""
    flat = flatten(polygon)
    left = list(range(len(polygon)))
    triangles = []
    while len(left) > 3:
        ring = flat[left]
        before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
        turn = cross2(ring - before, after - ring)
        # Sharp ears first: the shortest cut makes the roundest triangles.
        cut = ((after - before) ** 2).sum(axis=1)
        candidates = np.flatnonzero(turn > 0)
        candidates = candidates[np.argsort(cut[candidates], kind="stable")]
        reflex = ring[turn <= 0]
        ears = (i for i in candidates if not any_inside(reflex, before[i], ring[i], after[i]))
        # A polygon without ears is degenerate or crosses itself: drop its flattest corner.
        ear = int(next(ears, np.abs(turn).argmin()))
        triangles.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array([*triangles, left])


def flatten(polygon: Float[np.ndarray, "corners 3"]) -> Float[np.ndarray, "corners 2"]:
    """Project a polygon into the plane across its area vector (Newell's normal), turning counter-clockwise."""
    centred = polygon - polygon.mean(axis=0)
    normal = np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)
    drop = int(np.abs(normal).argmax())
    kept = [(drop + 1) % 3, (drop + 2) % 3]
    flat = centred[:, kept]
    return flat if normal[drop] >= 0 else flat * [1.0, -1.0]


def cross2(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def any_inside(points: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> bool:
    """Tell whether a point lies in the counter-clockwise triangle a b c or on its border, its corners apart."""
    other = ~((points == a).all(axis=1) | (points == b).all(axis=1) | (points == c).all(axis=1))
    points = points[other]
    sides = [cross2(end - start, points - start) >= 0 for start, end in ((a, b), (b, c), (c, a))]
    return bool(np.logical_and.reduce(sides).any())
