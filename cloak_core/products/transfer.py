"""A logo and its colours from one body to another of other topology.

Both bodies are taken in their first pose, preferably alike (standing). The source is scaled and moved onto the target
by height, soles and the middle of the surface. Then every target face is asked which source faces lie closest under
it, facing the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64, Integer
from scipy.spatial import KDTree
from trimesh.triangles import closest_point

from cloak_core.core.geometry import PLACES, area_vectors, face_areas, sum_by_face
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError


@dataclass(frozen=True, eq=False)
class Transfer:
    """What became of a logo of L faces on the target."""

    face_ids: np.ndarray
    """[L'] int64, sorted: faces of the target whose area lies at least half on the logo."""
    colors: np.ndarray | None
    """[L', 3] float32: means of the source's colours, weighted by area."""
    coverage: float
    """Share of the source logo's area that found a place."""
    largest_distance: float
    """Metres, of the places found."""
    unplaced: np.ndarray
    """[U] int64: source faces without a place."""


def transfer_logo(
    source: Bodies,
    face_ids: Integer[np.ndarray, " logo"],
    target: Bodies,
    colors: Float32[np.ndarray, "colors 3"] | None = None,
    reach: float = 0.08,
) -> Transfer:
    """Carry a logo of `source` over to `target`.

    reach: metres beyond which surfaces do not belong together. Raises `InputError` where nothing can be placed.
    """
    if colors is not None and len(colors) != len(face_ids):
        raise InputError(f"colours for {len(colors)} faces, but the logo has {len(face_ids)}")
    position = np.full(source.face_count, -1)
    position[face_ids] = np.arange(len(face_ids))
    above, below = surface(target), surface(align(source, target))
    is_logo = position[source.triangle_face] >= 0
    ids, placed = logo_under(above, below, target, position[source.triangle_face], reach)
    if not len(ids):
        raise InputError(f"no face of '{target.name}' lies within {reach:g} m of the logo on '{source.name}'")
    unplaced, distance = missed(below.part(is_logo), source.triangle_face[is_logo], above, reach)
    areas = face_areas(source)[face_ids]
    return Transfer(
        face_ids=ids,
        colors=None if colors is None else mixed(colors, *placed, len(ids)),
        coverage=float(areas[~np.isin(face_ids, unplaced)].sum() / areas.sum()),
        largest_distance=distance,
        unplaced=unplaced,
    )


class Surface(NamedTuple):
    """Triangles of a body in its first pose."""

    corners: Float[np.ndarray, "t 3 3"]
    areas: Float[np.ndarray, " t"]
    normals: Float[np.ndarray, "t 3"]

    def part(self, chosen: np.ndarray) -> Surface:
        """Select triangles."""
        return Surface(*(values[chosen] for values in self))

    def near(self, others: Surface, margin: float) -> Bool[np.ndarray, " t"]:
        """Tell which triangles touch the others' bounding box with a margin (metres) around it."""
        low, high = others.corners.min(axis=(0, 1)) - margin, others.corners.max(axis=(0, 1)) + margin
        return ((self.corners.max(axis=1) > low) & (self.corners.min(axis=1) < high)).all(axis=1)


def surface(bodies: Bodies) -> Surface:
    """Collect the triangles of the first pose, metres."""
    vectors, _ = area_vectors(bodies, 0)
    areas = np.linalg.norm(vectors, axis=1)
    corners = bodies.vertices[0][bodies.triangles].astype(np.float64)
    return Surface(corners, areas, vectors / np.maximum(areas, 1e-30)[:, None])


def align(source: Bodies, target: Bodies) -> Bodies:
    """Move the source's first pose onto the target: as high, soles level, the surfaces' middles in line."""
    boxes, middles = [], []
    for bodies in (source, target):
        vectors, centroid = area_vectors(bodies, 0)
        area = np.linalg.norm(vectors, axis=1)
        middles.append((centroid * area[:, None]).sum(axis=0) / area.sum())
        y = bodies.vertices[0][:, 1].astype(np.float64)
        boxes.append((y.min(), y.max()))
    scale = (boxes[1][1] - boxes[1][0]) / max(boxes[0][1] - boxes[0][0], 1e-9)
    origin, goal = (np.array([m[0], box[0], m[2]]) for m, box in zip(middles, boxes, strict=True))
    moved = (source.vertices[:1] - origin) * scale + goal
    return replace(source, vertices=moved, names=source.names[:1], recorded_topology=source.topology)


def logo_under(
    above: Surface, below: Surface, target: Bodies, logo: Integer[np.ndarray, " t"], reach: float
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Find the target faces that lie on the logo [L'], and what lies under them.

    logo: position in the logo of each triangle `below`, -1 for others. What lies under them comes as pieces of area:
    the target face (its position in the result), the logo face below (its position), square metres.
    """
    on_logo = below.part(logo >= 0)
    near, around = above.near(on_logo, reach), below.near(on_logo, 3 * reach)
    if not near.any():
        empty = np.zeros(0, np.int64)
        return empty, (empty, empty, np.zeros(0))
    points = np.einsum("pk,tkc->tpc", PLACES, above.corners[near]).reshape(-1, 3)
    normals = np.repeat(above.normals[near], len(PLACES), axis=0)
    nearest, _ = nearest_triangles(points, normals, below.corners[around], reach)
    face = np.where(nearest >= 0, logo[around][nearest], -1)
    weight = np.repeat(above.areas[near] / len(PLACES), len(PLACES))
    owner = np.repeat(target.triangle_face[near], len(PLACES))
    covered = np.bincount(owner[face >= 0], weights=weight[face >= 0], minlength=target.face_count)
    ids = np.flatnonzero((covered >= 0.5 * sum_by_face(target, above.areas)) & (covered > 0)).astype(np.int64)
    row = np.full(target.face_count, -1)
    row[ids] = np.arange(len(ids))
    use = (face >= 0) & (row[owner] >= 0)
    return ids, (row[owner[use]], face[use], weight[use])


def mixed(
    colors: Float32[np.ndarray, "colors 3"], row: np.ndarray, face: np.ndarray, weight: np.ndarray, count: int
) -> Float32[np.ndarray, "places 3"]:
    """Average the logo's colours over each of `count` target faces, by area."""
    total = np.maximum(np.bincount(row, weights=weight, minlength=count), 1e-30)
    channels = [np.bincount(row, weights=weight * colors[face, c], minlength=count) / total for c in range(3)]
    return np.clip(np.stack(channels, axis=1), 0, 1).astype(np.float32)


def missed(logo: Surface, faces: Integer[np.ndarray, " t"], above: Surface, reach: float) -> tuple[np.ndarray, float]:
    """Find logo faces without a surface of the target in reach facing their way, and the others' largest distance."""
    near = above.near(logo, 2 * reach)
    if not near.any():
        return np.unique(faces).astype(np.int64), 0.0
    nearest, distance = nearest_triangles(logo.corners.mean(axis=1), logo.normals, above.corners[near], reach)
    reached = nearest >= 0
    lost = np.setdiff1d(faces, faces[reached]).astype(np.int64)
    return lost, float(distance[reached].max(initial=0))


CANDIDATES = 32
"""Triangles, by the distance of their centroids, that are measured exactly; more where none of them faces right."""
PAIRS = 1 << 20
"""Of points and triangles, that are looked at together."""
LEAST_COSINE = 0.3
"""Of a triangle's normal with a point's, to face its way."""


def nearest_triangles(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    triangles: Float[np.ndarray, "t 3 3"],
    reach: float,
) -> tuple[Int64[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Find the closest triangle to each point within `reach` metres, of those that face the point's way.

    Returns the triangles (-1 where there is none) and the distances to them (inf there).
    """
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    facing = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30)
    centroid = triangles.mean(axis=1)
    tree = KDTree(centroid)
    radius = np.linalg.norm(triangles - centroid[:, None], axis=2).max()
    nearest, distances = np.full(len(points), -1, np.int64), np.full(len(points), np.inf)
    count = CANDIDATES
    left = np.arange(len(points))
    while len(left):
        count = min(count, len(triangles))
        further = []
        for part in np.array_split(left, len(left) * count // PAIRS + 1):
            away, chosen = tree.query(points[part], np.arange(1, count + 1))
            row, column = np.nonzero(np.einsum("nk,nck->nc", normals[part], facing[chosen]) >= LEAST_COSINE)
            exact = np.full(chosen.shape, np.inf)
            asked = points[part[row]]
            # Of a triangle without area, too, the closest point is right.
            exact[row, column] = np.linalg.norm(asked - closest_point(triangles[chosen[row, column]], asked), axis=1)
            best = exact.argmin(axis=1)[:, None]
            distance = np.take_along_axis(exact, best, axis=1)[:, 0]
            near = distance <= reach
            nearest[part[near]] = np.take_along_axis(chosen, best, axis=1)[near, 0]
            distances[part[near]] = distance[near]
            further.append(part[~near & (away[:, -1] <= reach + radius)])
        left = np.concatenate(further) if count < len(triangles) else left[:0]
        count *= 4
    return nearest, distances
