"""What the geometry of bodies says about faces, edges and surfaces.

Everything measured here is measured in metres in one pose, the first unless told otherwise; a face is
a polygon.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Integer
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from cloak_core.core.polygons import next_corner, polygon_loops
from cloak_core.exchange.bodies import Bodies, area_vectors, sum_by_face
from cloak_core.exchange.bodies import face_normals as face_normals

PLACES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])
"""Points inside a triangle (weights of its corners) that stand for its area, a quarter each."""


def face_areas(bodies: Bodies, pose: int = 0) -> Float[np.ndarray, " faces"]:
    """Compute the area of every face in square metres (the sum of its triangles'), float64."""
    vectors, _ = area_vectors(bodies, pose)
    return sum_by_face(bodies, np.linalg.norm(vectors, axis=1))


def vertex_normals(bodies: Bodies, pose: int = 0) -> Float[np.ndarray, "vertices 3"]:
    """Compute unit normals: the mean of the triangles around a vertex, by area; zero for a vertex without any."""
    vectors, _ = area_vectors(bodies, pose)
    total = np.zeros((bodies.vertex_count, 3))
    for corner in range(3):
        np.add.at(total, bodies.triangles[:, corner], vectors)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def face_centres(bodies: Bodies, pose: int = 0) -> Float[np.ndarray, "faces 3"]:
    """Compute centroids, weighted by area; of a face without area, the mean of its triangles' corners."""
    vectors, centroid = area_vectors(bodies, pose)
    area = np.linalg.norm(vectors, axis=1)
    flat = sum_by_face(bodies, area)[bodies.triangle_face] == 0
    weight = np.where(flat, 1.0, area)
    return sum_by_face(bodies, centroid * weight[:, None]) / np.maximum(sum_by_face(bodies, weight), 1e-300)[:, None]


def outward_parts(bodies: Bodies) -> Bool[np.ndarray, "poses triangles"]:
    """Tell per pose which triangles belong to closed surfaces that face outwards: nobody outside sees their backs."""
    part = connected_parts(bodies.triangles, bodies.vertex_count)[bodies.triangles[:, 0]]
    outward = np.zeros((bodies.pose_count, bodies.triangle_count), bool)
    if not bodies.triangle_count:
        return outward
    start, end = bodies.triangles.astype(np.int64), np.roll(bodies.triangles, -1, axis=1).astype(np.int64)
    walked, count = np.unique(start * bodies.vertex_count + end, return_counts=True)
    back = end * bodies.vertex_count + start
    paired = walked[np.searchsorted(walked, back).clip(max=len(walked) - 1)] == back
    once = count[np.searchsorted(walked, start * bodies.vertex_count + end)] == 1
    open_parts = part[~(paired & once & (start != end)).all(1)]
    closed = ~np.isin(part, open_parts)
    for pose in range(bodies.pose_count):
        # Each closed part's volume, by the divergence theorem; of any origin, but one nearby rounds less.
        vectors, centroid = area_vectors(bodies, pose)
        volume = np.bincount(part, weights=(vectors * (centroid - centroid.mean(axis=0))).sum(axis=1) / 3)
        outward[pose] = closed & (volume > 0)[part]
    return outward


def connected_parts(faces: Integer[np.ndarray, "faces corners"], vertex_count: int) -> Integer[np.ndarray, " vertices"]:
    """Number the connected part of each vertex, from 0: faces join their corners."""
    ends = np.repeat(faces[:, 0], faces.shape[1]), faces.reshape(-1)
    joined = csr_matrix((np.ones(faces.size, bool), ends), shape=(vertex_count, vertex_count))
    return connected_components(joined, directed=False)[1]


def inner_edges(
    bodies: Bodies, face_ids: Integer[np.ndarray, " logo"]
) -> tuple[Integer[np.ndarray, "edges 2"], Float[np.ndarray, " edges"]]:
    """Find the edges between two faces of a logo, and their lengths [E], metres, in the first pose.

    Edges are pairs of positions in `face_ids` [E, 2], lower first. Faces with two edges in common appear twice; an edge
    of three faces joins each two.
    """
    loop_total, loop_vertices, face = polygon_loops(bodies)
    position = np.full(bodies.face_count, -1, np.int64)
    position[face_ids] = np.arange(len(face_ids))
    ends = np.stack([loop_vertices, loop_vertices[next_corner(loop_total)]], axis=1).astype(np.int64)
    ends.sort(axis=1)
    owner = position[np.repeat(face, loop_total)]
    ends = ends[owner >= 0]
    owner = owner[owner >= 0]
    order = np.lexsort((owner, ends[:, 1], ends[:, 0]))
    ends = ends[order]
    owner = owner[order]
    matches = []
    # Equal edges lie side by side now: compare each with the next, then the one after, until none is equal.
    for step in range(1, len(ends)):
        same = np.flatnonzero((ends[step:] == ends[:-step]).all(axis=1))
        if not len(same):
            break
        matches.append(np.stack([same, same + step], axis=1))
    pairs = np.concatenate(matches) if matches else np.zeros((0, 2), np.int64)
    pairs = pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]]
    a, b = (bodies.vertices[0][ends[pairs[:, 0], side]].astype(np.float64) for side in (0, 1))
    return owner[pairs], np.linalg.norm(a - b, axis=1)
