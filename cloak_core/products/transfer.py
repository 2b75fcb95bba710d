"""A logo and its colours from one body to another of other topology.

Both bodies are taken in their first pose, preferably alike (standing). The source is scaled and moved onto the target
by height, soles and the middle of the surface. Then every target face is asked which source faces lie closest under
it, facing the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer
from scipy.spatial import KDTree

from cloak_core.core.geometry import PLACES, area_vectors, face_areas, sum_by_face
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError

Shares = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Pieces of area: the target face (its position in the result), the logo face below (its position), square metres."""


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
    moved = align(source, target)
    position = np.full(source.face_count, -1)
    position[face_ids] = np.arange(len(face_ids))
    ids, shares = logo_under(target, moved, position, reach)
    if not len(ids):
        raise InputError(f"no face of '{target.name}' lies within {reach:g} m of the logo on '{source.name}'")
    unplaced, distance = missed(moved, face_ids, target, reach)
    areas = face_areas(source)[face_ids]
    placed = ~np.isin(face_ids, unplaced)
    return Transfer(
        face_ids=ids,
        colors=None if colors is None else mixed(colors, shares, len(ids)),
        coverage=float(areas[placed].sum() / areas.sum()),
        largest_distance=distance,
        unplaced=unplaced,
    )


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


def logo_under(target: Bodies, source: Bodies, position: np.ndarray, reach: float) -> tuple[np.ndarray, Shares]:
    """Find the target faces that lie on the logo [L'], and which logo faces lie under them."""
    triangles, solid = solids(target), solids(source)
    logo = solid[position[source.triangle_face] >= 0]
    near, around = within(triangles, logo, reach), within(solid, logo, 3 * reach)
    if not near.any():
        empty = np.zeros(0, np.int64)
        return empty, (empty, empty, np.zeros(0))
    points = np.einsum("pk,tkc->tpc", PLACES, triangles[near]).reshape(-1, 3)
    area, normals = sizes(target)
    found = nearest_triangles(points, np.repeat(normals[near], len(PLACES), axis=0), solid[around], reach)
    face = np.where(found.triangle >= 0, position[source.triangle_face[around][found.triangle]], -1)
    weight = np.repeat(area[near] / len(PLACES), len(PLACES))
    owner = np.repeat(target.triangle_face[near], len(PLACES))
    on_logo = np.bincount(owner[face >= 0], weights=weight[face >= 0], minlength=target.face_count)
    ids = np.flatnonzero((on_logo >= 0.5 * sum_by_face(target, area)) & (on_logo > 0)).astype(np.int64)
    row = np.full(target.face_count, -1)
    row[ids] = np.arange(len(ids))
    use = (face >= 0) & (row[owner] >= 0)
    return ids, (row[owner[use]], face[use], weight[use])


def solids(bodies: Bodies) -> Float[np.ndarray, "triangles 3 3"]:
    """Collect the triangles' corners in the first pose."""
    return bodies.vertices[0][bodies.triangles].astype(np.float64)


def sizes(bodies: Bodies) -> tuple[Float[np.ndarray, " triangles"], Float[np.ndarray, "triangles 3"]]:
    """Compute the triangles' areas and unit normals in the first pose."""
    vectors, _ = area_vectors(bodies, 0)
    area = np.linalg.norm(vectors, axis=1)
    return area, vectors / np.maximum(area, 1e-30)[:, None]


def within(
    triangles: Float[np.ndarray, "t 3 3"], others: Float[np.ndarray, "n 3 3"], margin: float
) -> Bool[np.ndarray, " t"]:
    """Tell which triangles touch the others' bounding box with a margin (metres) around it."""
    low, high = others.min(axis=(0, 1)) - margin, others.max(axis=(0, 1)) + margin
    return ((triangles.max(axis=1) > low) & (triangles.min(axis=1) < high)).all(axis=1)


def mixed(colors: Float32[np.ndarray, "colors 3"], shares: Shares, count: int) -> Float32[np.ndarray, "places 3"]:
    """Average the logo's colours over each of `count` target faces, by area."""
    row, face, weight = shares
    total = np.maximum(np.bincount(row, weights=weight, minlength=count), 1e-30)
    channels = [np.bincount(row, weights=weight * colors[face, c], minlength=count) / total for c in range(3)]
    return np.clip(np.stack(channels, axis=1), 0, 1).astype(np.float32)


def missed(source: Bodies, face_ids: np.ndarray, target: Bodies, reach: float) -> tuple[np.ndarray, float]:
    """Find logo faces without a surface of the target in reach facing their way, and the others' largest distance."""
    mine = np.flatnonzero(np.isin(source.triangle_face, face_ids))
    solid, triangles = solids(source)[mine], solids(target)
    near = within(triangles, solid, 2 * reach)
    if not near.any():
        return np.asarray(face_ids, np.int64), 0.0
    normals = sizes(source)[1][mine]
    found = nearest_triangles(solid.mean(axis=1), normals, triangles[near], reach)
    reached = found.triangle >= 0
    lost = np.setdiff1d(face_ids, source.triangle_face[mine[reached]]).astype(np.int64)
    return lost, float(found.distance[reached].max(initial=0))


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
