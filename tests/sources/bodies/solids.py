"""Small meshes that the tests of the scene room share."""

import dataclasses

import numpy as np

from cloak_core.core.polygons import triangulate
from cloak_core.exchange.bodies import Bodies


def polygons(vertices: np.ndarray, faces: list[list[int]], **fields: object) -> Bodies:
    """Bodies of one pose from polygons."""
    total = np.array([len(face) for face in faces], np.int32)
    loop = np.concatenate([np.asarray(face, np.int32) for face in faces])
    points = np.asarray(vertices, np.float32)
    corners, triangle_face = triangulate(points, total, loop)
    return Bodies(points[None], loop[corners], triangle_face, loop_total=total, loop_vertices=loop, **fields)


CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
# Outwards, counter-clockwise: -x, +x, -y, +y, -z, +z.
CUBE_FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def cube(**fields: object) -> Bodies:
    return polygons(CUBE, CUBE_FACES, **fields)


def sphere(columns: int, rows: int) -> Bodies:
    """A closed globe of `columns * rows` quads between two caps of `columns` triangles."""
    theta = np.linspace(0, np.pi, rows + 3)[1:-1]
    phi = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    ring = [[np.sin(t) * np.sin(p), np.cos(t), np.sin(t) * np.cos(p)] for t in theta for p in phi]
    vertices = np.array([[0, 1, 0], *ring, [0, -1, 0]])
    at = lambda row, column: 1 + row * columns + column % columns
    last = len(vertices) - 1
    faces = [[0, at(0, c), at(0, c + 1)] for c in range(columns)]
    faces += [[at(r, c), at(r + 1, c), at(r + 1, c + 1), at(r, c + 1)] for r in range(rows) for c in range(columns)]
    faces += [[last, at(rows, c + 1), at(rows, c)] for c in range(columns)]
    return polygons(vertices, faces)


def sheet(cells: int, side: float = 1.0, **fields: object) -> Bodies:
    """A square of `cells * cells` quads from the origin, facing +z; its texture coordinates go from 0 to 1."""
    axis = np.linspace(0, 1, cells + 1)
    uv = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    corner = np.add.outer(np.arange(cells) * (cells + 1), np.arange(cells)).ravel()
    quads = np.add.outer(corner, [0, 1, cells + 2, cells + 1])
    flat = polygons(np.insert(uv * side, 2, 0, axis=1), quads.tolist())
    return dataclasses.replace(flat, uv=uv.astype(np.float32), triangle_uv=flat.triangles, **fields)


def is_closed(triangles: np.ndarray) -> bool:
    """Whether triangles form closed, oriented surfaces: every edge is walked once in each direction.

    No triangles: False.
    """
    if not len(triangles):
        return False
    starts = triangles.astype(np.int64)
    ends = np.roll(starts, -1, axis=1)
    base = int(triangles.max()) + 1
    forward = np.sort((starts * base + ends).ravel())
    backward = np.sort((ends * base + starts).ravel())
    once = bool((np.diff(forward) > 0).all())
    return once and np.array_equal(forward, backward) and not bool((starts == ends).any())
