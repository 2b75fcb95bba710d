"""Closest points on a triangle mesh, among triangles that face the same way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

CANDIDATES = 24
"""Triangles, by the distance of their centroids, that are measured exactly."""
GROUP = 256
"""Points, neighbours of each other, that share one search for triangles around them."""
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
    """The closest triangle to each point within `reach` metres, of those that face the point's way."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    facing = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30)
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    best = np.full(len(points), -1, np.int64)
    distance = np.full(len(points), np.inf)
    # Most surfaces lie close together: look nearby first, and further only for the points that found nothing there.
    for margin in (reach / 16, reach / 4, reach):
        open_points = np.flatnonzero(best < 0)
        for group in groups(points, open_points):
            start, end = points[group].min(axis=0) - margin, points[group].max(axis=0) + margin
            around = np.flatnonzero(((high >= start) & (low <= end)).all(axis=1))
            if len(around):
                found, far = closest(points[group], normals[group], triangles[around], facing[around])
                sure = far <= margin
                best[group[sure]], distance[group[sure]] = around[found[sure]], far[sure]
    return Nearest(best, distance)


def groups(points: np.ndarray, chosen: np.ndarray) -> list[np.ndarray]:
    """Halves of halves along the longest side, until none has more than `GROUP` points."""
    pending, done = [chosen], []
    while pending:
        part = pending.pop()
        if len(part) <= GROUP:
            done.append(part)
            continue
        axis = int(np.ptp(points[part], axis=0).argmax())
        part = part[np.argsort(points[part, axis], kind="stable")]
        pending += [part[: len(part) // 2], part[len(part) // 2 :]]
    return [part for part in done if len(part)]


def closest(
    points: np.ndarray, normals: np.ndarray, triangles: np.ndarray, facing: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """For a few points and triangles: the closest triangle that faces the point's way, and its distance (or inf)."""
    centroid = triangles.mean(axis=1)
    # Squared distances to the centroids, but for a constant of each point.
    near = (centroid**2).sum(axis=1) - 2 * points @ centroid.T
    near[normals @ facing.T < LEAST_COSINE] = np.inf
    count = min(CANDIDATES, len(triangles))
    chosen = np.argpartition(near, count - 1, axis=1)[:, :count]
    exact = point_distances(np.repeat(points, count, axis=0), triangles[chosen.reshape(-1)]).reshape(-1, count)
    exact[~np.isfinite(np.take_along_axis(near, chosen, axis=1))] = np.inf
    winner = exact.argmin(axis=1)
    rows = np.arange(len(points))
    return chosen[rows, winner], exact[rows, winner]


def point_distances(points: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, " n"]:
    """Distance of each point to its own triangle, degenerate ones included."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    square = (normal**2).sum(axis=1)
    inside = square > 1e-30
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(end - start, points - start) * normal).sum(axis=1) >= 0
    above = np.abs(((points - a) * normal).sum(axis=1)) / np.sqrt(np.maximum(square, 1e-30))
    edges = [segment_distances(points, start, end) for start, end in ((a, b), (b, c), (c, a))]
    return np.where(inside, above, np.minimum.reduce(edges))


def segment_distances(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> Float[np.ndarray, " n"]:
    along = end - start
    square = np.maximum((along**2).sum(axis=1), 1e-30)
    t = np.clip(((points - start) * along).sum(axis=1) / square, 0, 1)
    return np.linalg.norm(points - start - along * t[:, None], axis=1)
