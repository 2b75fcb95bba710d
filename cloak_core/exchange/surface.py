"""Areas and normals of a body's faces, in metres, in one pose: what the trainer and Blender have to agree about."""

from __future__ import annotations

import numpy as np

from .bodies import Bodies


def area_vectors(bodies: Bodies, pose: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute each triangle's normal times its area [T, 3], and its centroid [T, 3]; float64."""
    corners = bodies.vertices[pose][bodies.triangles].astype(np.float64)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    return np.cross(b - a, c - a) / 2, corners.mean(axis=1)


def sum_by_face(bodies: Bodies, values: np.ndarray) -> np.ndarray:
    """Sum per-triangle values over each face."""
    total = np.zeros((bodies.face_count, *values.shape[1:]))
    np.add.at(total, bodies.triangle_face, values)
    return total


def face_normals(bodies: Bodies) -> np.ndarray:
    """Compute unit normals [F, 3] in the first pose: outwards where corners turn counter-clockwise.

    Zero for a face without area.
    """
    vectors, _ = area_vectors(bodies, 0)
    normal = sum_by_face(bodies, vectors)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
