"""Closest points on a triangle mesh, among triangles that face the same way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

CANDIDATES = 32
"""Triangles, by the distance of their centroids, that are measured exactly; more where none of them faces right."""
PAIRS = 1 << 20
"""Of points and triangles, that are looked at together."""
LEAST_COSINE = 0.3
"""Of a triangle's normal with a point's, to face its way."""


@dataclass(frozen=True, eq=False)
class Nearest:
    """For each of N points: the closest triangle (-1 where none faces its way) and the distance to it (inf there)."""

    triangle: np.ndarray
    """[N] int64."""
    distance: np.ndarray
    """[N] float64 metres."""


def nearest_triangles(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    triangles: Float[np.ndarray, "t 3 3"],
    reach: float,
) -> Nearest:
    """Find the closest triangle to each point within `reach` metres, of those that face the point's way."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    facing = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30)
    centroid = triangles.mean(axis=1)
    tree, radius = KDTree(centroid), np.linalg.norm(triangles - centroid[:, None], axis=2).max()
    found = Nearest(np.full(len(points), -1, np.int64), np.full(len(points), np.inf))
    count, left = CANDIDATES, np.arange(len(points))
    while len(left):
        count, further = min(count, len(triangles)), []
        for part in np.array_split(left, len(left) * count // PAIRS + 1):
            away, chosen = tree.query(points[part], np.arange(1, count + 1))
            row, column = np.nonzero(np.einsum("nk,nck->nc", normals[part], facing[chosen]) >= LEAST_COSINE)
            exact = np.full(chosen.shape, np.inf)
            exact[row, column] = point_distances(points[part[row]], triangles[chosen[row, column]])
            best = exact.argmin(axis=1)[:, None]
            distance = np.take_along_axis(exact, best, axis=1)[:, 0]
            near = distance <= reach
            found.triangle[part[near]] = np.take_along_axis(chosen, best, axis=1)[near, 0]
            found.distance[part[near]] = distance[near]
            further.append(part[~near & (away[:, -1] <= reach + radius)])
        left = np.concatenate(further) if count < len(triangles) else left[:0]
        count *= 4
    return found


def point_distances(points: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, " n"]:
    """Measure the distance of each point to its own triangle, degenerate ones included."""
    import trimesh

    return np.linalg.norm(points - trimesh.triangles.closest_point(triangles, points), axis=1)
