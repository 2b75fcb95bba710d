"""A logo and its colours from one body to another of other topology.

Both bodies are taken in their first pose, preferably alike (standing). The source is scaled and moved onto the target
by height, soles and the middle of the surface. Then every target face is asked which source faces lie closest under
it, facing the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer

from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.output.nearest import nearest_triangles
from cloak_core.scene.geometry import PLACES, area_vectors, face_areas, sum_by_face

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
