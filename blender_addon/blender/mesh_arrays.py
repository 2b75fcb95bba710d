# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's data as numpy arrays, read and written in one place.

P polygons (faces), V vertices, T triangles, C corners of all polygons one after the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bmesh
import bpy
import numpy as np


def sync(obj: bpy.types.Object) -> None:
    """Bring the mesh up to date with Edit Mode: `foreach_get` reads stale data otherwise."""
    if obj.mode == "EDIT":
        obj.update_from_editmode()


_open: dict[int, bpy.types.Mesh] = {}
"""Copies of meshes in Edit Mode that are in use now, by their object's `session_uid`."""


@contextmanager
def current_mesh(obj: bpy.types.Object) -> Iterator[bpy.types.Mesh]:
    """The object's own mesh as it is now: itself, or in Edit Mode a copy of what is being edited, to be read only.

    The copy has every layer but the shape keys, and Blender reads it several times as fast as the mesh under editing.
    Within an outer `current_mesh` of the same object it is the outer one's, until `edited` says that it has aged.
    """
    uid = obj.session_uid
    if obj.mode != "EDIT" or uid in _open:
        yield _open.get(uid, obj.data)
        return
    copy = _open[uid] = bpy.data.meshes.new(".cloak edited")
    try:
        bmesh.from_edit_mesh(obj.data).to_mesh(copy)
        yield copy
    finally:
        edited(obj)
        bpy.data.meshes.remove(copy, do_unlink=False)


@contextmanager
def bmesh_of(obj: bpy.types.Object) -> Iterator[bmesh.types.BMesh]:
    """The mesh that is being edited; in Object Mode a copy of the object's own."""
    if obj.mode == "EDIT":
        yield bmesh.from_edit_mesh(obj.data)
        return
    bm = bmesh.new()
    try:
        bm.from_mesh(obj.data)
        yield bm
    finally:
        bm.free()


def edited(obj: bpy.types.Object) -> None:
    """The mesh in Edit Mode was changed: `current_mesh` makes a new copy."""
    _open.pop(obj.session_uid, None)


def face_count(obj: bpy.types.Object) -> int:
    """How many faces the object's own mesh has now."""
    return len(bmesh.from_edit_mesh(obj.data).faces) if obj.mode == "EDIT" else len(obj.data.polygons)


def read(items: bpy.types.bpy_prop_collection, name: str, width: int = 1, dtype: type = np.float32) -> np.ndarray:
    """One property of every item: [n], or [n, width] for a property of several numbers."""
    values = np.empty(width * len(items), dtype)
    items.foreach_get(name, values)
    return values.reshape(-1, width) if width > 1 else values


def vertex_points(mesh: bpy.types.Mesh) -> np.ndarray:
    """[V, 3] float32; from the attribute, which is ten times as fast as from the vertices."""
    places = mesh.attributes.get("position")
    if places is not None and len(places.data) == len(mesh.vertices):
        return read(places.data, "vector", 3)
    return read(mesh.vertices, "co", 3)


def face_normals(mesh: bpy.types.Mesh) -> np.ndarray:
    """[P, 3] float32, of length one."""
    return read(mesh.polygon_normals, "vector", 3)


def hidden_faces(mesh: bpy.types.Mesh) -> np.ndarray:
    """Mask [P]."""
    return _flags(mesh, ".hide_poly", len(mesh.polygons))


def selected(mesh: bpy.types.Mesh, kind: str) -> np.ndarray:
    """Mask of the selected "vertices", "edges" or "polygons"."""
    name = {"vertices": ".select_vert", "edges": ".select_edge", "polygons": ".select_poly"}[kind]
    return _flags(mesh, name, len(getattr(mesh, kind)))


def _flags(mesh: bpy.types.Mesh, name: str, count: int) -> np.ndarray:
    """Blender's own flags; it makes the attribute when the first one is set."""
    attribute = mesh.attributes.get(name)
    return np.zeros(count, bool) if attribute is None else read(attribute.data, "value", dtype=bool)


def write_attribute(mesh: bpy.types.Mesh, name: str, kind: str, values: np.ndarray) -> None:
    """Set the face attribute `name`, made where there is none; `kind` is "BOOLEAN", "INT" or "FLOAT"."""
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, kind, "FACE")
    attribute.data.foreach_set("value", np.ascontiguousarray(values))
    mesh.update_tag()


def polygon_loops(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The polygons' vertex loops: corner counts [P] int32 and vertex indices [C] int32."""
    return corner_counts(mesh), _of_corners(mesh, ".corner_vert", "vertex_index")


def corner_edges(mesh: bpy.types.Mesh) -> np.ndarray:
    """[C] int32: the edge from each corner to the next."""
    return _of_corners(mesh, ".corner_edge", "edge_index")


def _of_corners(mesh: bpy.types.Mesh, name: str, property: str) -> np.ndarray:
    attribute = mesh.attributes.get(name)
    if attribute is not None and len(attribute.data) == len(mesh.loops):
        return read(attribute.data, "value", dtype=np.int32)  # ten times as fast as through the loops
    return read(mesh.loops, property, dtype=np.int32)


def corner_counts(mesh: bpy.types.Mesh) -> np.ndarray:
    """[P] int32."""
    return np.diff(read(mesh.polygons, "loop_start", dtype=np.int32), append=np.int32(len(mesh.loops)))


def corners_by_size(counts: np.ndarray, loops: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Faces [n] with as many corners each, and their vertices [n, size]; one size after the other."""
    starts = np.cumsum(counts) - counts
    for size in np.flatnonzero(np.bincount(counts)):
        faces = np.flatnonzero(counts == size)
        yield faces, loops[starts[faces][:, None] + np.arange(size)]


def face_centers(points: np.ndarray, counts: np.ndarray, loops: np.ndarray) -> np.ndarray:
    """[P, 3] means of the faces' corners, as Blender's own centres are, which take it twice as long."""
    centers = np.empty((len(counts), 3), points.dtype)
    for faces, corners in corners_by_size(counts, loops):
        centers[faces] = sum((points[corner] for corner in corners.T[1:]), points[corners[:, 0]]) / corners.shape[1]
    return centers


def mean_of_corners(mesh: bpy.types.Mesh, values: np.ndarray) -> np.ndarray:
    """[P, n]: the mean over each face's corners of values [C, n]."""
    counts = corner_counts(mesh)
    starts = np.concatenate(([0], np.cumsum(counts)[:-1]))
    return np.add.reduceat(values, starts, axis=0) / counts[:, None]


def mesh_triangles(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Blender's own triangulation: vertex indices [T, 3] and the polygon of each triangle [T], int32."""
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    return read(triangles, "vertices", 3, np.int32), read(triangles, "polygon_index", dtype=np.int32)


def face_triangles(mesh: bpy.types.Mesh, mask: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Like `mesh_triangles`, for the faces of a mask [P] alone and in no set order: vertex indices [T, 3], faces [T].

    Triangles and quads are split here, by Blender's rule (along the first diagonal, unless that folds the quad over);
    asking Blender for a million triangles takes a quarter of a second.
    """
    counts, loops = polygon_loops(mesh)
    starts = np.cumsum(counts) - counts
    faces = np.arange(len(counts)) if mask is None else np.flatnonzero(mask)
    large = counts[faces] > 4
    triangles, face = split_faces(vertex_points(mesh), starts, counts, loops, faces[~large])
    ngons, ngon_of = _ngon_triangles(mesh, faces[large], counts, starts)
    return np.concatenate([triangles, ngons]), np.concatenate([face, ngon_of])


def split_faces(
    points: np.ndarray, starts: np.ndarray, counts: np.ndarray, loops: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles [T, 3] of some faces and the face of each [T]; n-gons become fans, which suits convex ones alone."""
    three, four, more = (faces[sizes] for sizes in _by_size(counts[faces]))
    quads = loops[starts[four][:, None] + np.arange(4)]
    folded = _folded(points, quads)
    quads[folded] = np.roll(quads[folded], -1, axis=1)
    fan_of = np.repeat(more, counts[more] - 2)
    step = np.arange(len(fan_of)) - np.repeat(np.cumsum(counts[more] - 2) - (counts[more] - 2), counts[more] - 2)
    fans = loops[starts[fan_of][:, None] + np.stack([np.zeros_like(step), step + 1, step + 2], -1)]
    triangles = [loops[starts[three][:, None] + np.arange(3)], quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], fans]
    return np.concatenate(triangles), np.concatenate([three, four, four, fan_of])


def triangle_vectors(mesh: bpy.types.Mesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal times area [T, 3] of the triangles of `face_triangles`, the vertices at points [V, 3]; their faces [T]."""
    counts, loops = polygon_loops(mesh)
    starts = np.cumsum(counts) - counts
    three, four, more = (np.flatnonzero(sizes) for sizes in _by_size(counts))
    corners = points[loops[starts[four]]]
    a, diagonal, b = (points[loops[starts[four] + step]] - corners for step in (1, 2, 3))
    first, second = _cross(a, diagonal), _cross(diagonal, b)
    folded = np.flatnonzero(_dot(first, second) < 0)
    a, diagonal, b = a[folded], diagonal[folded], b[folded]
    first[folded], second[folded] = _cross(diagonal - a, b - a), _cross(a, b)
    ngons, ngon_of = _ngon_triangles(mesh, more, counts, starts)
    rest = np.concatenate([loops[starts[three][:, None] + np.arange(3)], ngons])
    others = _cross(points[rest[:, 1]] - points[rest[:, 0]], points[rest[:, 2]] - points[rest[:, 0]])
    return np.concatenate([first, second, others]) / 2, np.concatenate([four, four, three, ngon_of])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """numpy's own takes three times as long."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def _by_size(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return counts == 3, counts == 4, counts > 4


def _folded(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Mask of the quads [Q, 4] whose halves along the first diagonal lie on the same side of it."""
    a, b, diagonal = (points[quads[:, corner]] - points[quads[:, 0]] for corner in (1, 3, 2))
    # (a x d) . (b x d), by Lagrange's identity
    return _dot(a, b) * _dot(diagonal, diagonal) > _dot(a, diagonal) * _dot(b, diagonal)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)


def _ngon_triangles(
    mesh: bpy.types.Mesh, ngons: np.ndarray, counts: np.ndarray, starts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Blender's own triangles of faces with five corners and more."""
    if not len(ngons):
        return np.empty((0, 3), np.int32), np.empty(0, np.int64)
    mesh.calc_loop_triangles()
    sizes = counts[ngons] - 2
    face_of = np.repeat(ngons, sizes)
    # A face with n corners gives n - 2 triangles, so its first one's place is known.
    first = np.repeat(starts[ngons] - 2 * ngons - (np.cumsum(sizes) - sizes), sizes)
    places = (first + np.arange(len(face_of))).tolist()
    return np.array([mesh.loop_triangles[i].vertices[:] for i in places], np.int32), face_of


@contextmanager
def evaluated_mesh(obj: bpy.types.Object, graph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Mesh, np.ndarray]]:
    """The object's mesh with modifiers and shape keys applied, and its matrix to world space, [4, 4] float64."""
    evaluated = obj.evaluated_get(graph)
    try:
        yield evaluated.to_mesh(), np.array(evaluated.matrix_world, np.float64)
    finally:
        evaluated.to_mesh_clear()


def to_world(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Points [n, 3] through a matrix [4, 4], float64."""
    return points.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def box_of(obj: bpy.types.Object) -> np.ndarray:
    """Lowest and highest corner [2, 3] of the object's box, in the world."""
    corners = to_world(np.array(obj.bound_box), np.array(obj.matrix_world))
    return np.stack([corners.min(0), corners.max(0)])


def image_pixels(image: bpy.types.Image) -> np.ndarray:
    """[H, W, channels] float32 as stored, bottom row first."""
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], image.channels)
