# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's data as numpy arrays, read and written in one place.

P polygons (faces), V vertices, T triangles, C corners of all polygons one after the other.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import bmesh
import bpy
import numpy as np

from ..exchange.bodies import topology_hash
from ..files.errors import InputError

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


def edited(obj: bpy.types.Object) -> None:
    """The mesh in Edit Mode was changed: `current_mesh` makes a new copy."""
    _open.pop(obj.session_uid, None)


@contextmanager
def object_mode(obj: bpy.types.Object) -> Iterator[None]:
    """Leave Edit Mode during the block: writing a million values there takes Python as long as leaving it does."""
    editing = obj.mode == "EDIT"
    if editing:
        edited(obj)
        bpy.ops.object.mode_set(mode="OBJECT")
    try:
        yield
    finally:
        if editing:
            bpy.ops.object.mode_set(mode="EDIT")


def mode_reason(obj: bpy.types.Object, sentence: str) -> str:
    """What to say ("Leave {mode} to see ...") while the object is edited, painted, or sculpted; "" in Object Mode."""
    mode = obj.bl_rna.properties["mode"].enum_items[obj.mode].name + (" (Tab)" if obj.mode == "EDIT" else "")
    return "" if obj.mode == "OBJECT" else sentence.replace("{mode}", mode)


def require_object_mode(obj: bpy.types.Object, sentence: str) -> None:
    """Raise `InputError` while the object is in another mode than Object Mode."""
    if reason := mode_reason(obj, sentence):
        raise InputError(reason)


def choose(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Make an object the active one, and the only one that is selected."""
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


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
    return read(mesh.attributes["position"].data, "vector", 3)


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
    return corner_counts(mesh), corner_vertices(mesh)


def topology(obj: bpy.types.Object) -> str:
    """SHA-256 of the object's own (unmodified) polygons, current in Edit Mode too."""
    with current_mesh(obj) as mesh:
        return topology_hash(len(mesh.vertices), *polygon_loops(mesh))


def corner_vertices(mesh: bpy.types.Mesh) -> np.ndarray:
    """[C] int32; like the edges from the attribute, which is ten times as fast as through the loops."""
    return read(mesh.attributes[".corner_vert"].data, "value", dtype=np.int32)


def corner_edges(mesh: bpy.types.Mesh) -> np.ndarray:
    """[C] int32: the edge from each corner to the next."""
    return read(mesh.attributes[".corner_edge"].data, "value", dtype=np.int32)


def corner_counts(mesh: bpy.types.Mesh) -> np.ndarray:
    """[P] int32."""
    return np.diff(read(mesh.polygons, "loop_start", dtype=np.int32), append=np.int32(len(mesh.loops)))


def mean_of_corners(counts: np.ndarray, values: np.ndarray) -> np.ndarray:
    """[P, n]: the mean over each face's corners of values [C, n]."""
    return np.add.reduceat(values, np.cumsum(counts) - counts, axis=0) / counts[:, None].astype(values.dtype)


def mesh_triangles(mesh: bpy.types.Mesh, mask: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Blender's own triangulation, of the faces of `mask` [P] alone: vertex indices [T, 3] and polygons [T], int32."""
    loops, face = triangle_corners(mesh)
    chosen = slice(None) if mask is None else mask[face]
    return corner_vertices(mesh)[loops[chosen]], face[chosen]


def triangle_corners(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Blender's own triangulation: corners [T, 3] and the polygon of each triangle [T], int32."""
    mesh.calc_loop_triangles()
    # Of a triangle's vertices and polygon Blender computes each when it is read: twice the time.
    loops = read(mesh.loop_triangles, "loops", 3, np.int32)
    return loops, read(mesh.loop_triangle_polygons, "value", dtype=np.int32)


def triangle_areas(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """[T] areas of triangles, corners [T, 3] of points [V, 3]."""
    # Axis by axis, around the middle and in single precision: numpy takes a quarter of the time.
    axes = np.ascontiguousarray((points - points.mean(0)).T, np.float32)
    first, second, third = (axes.take(corners[:, corner], axis=1) for corner in range(3))
    a, b = second - first, third - first
    return np.sqrt(sum((a[i] * b[j] - a[j] * b[i]) ** 2 for i, j in ((0, 1), (1, 2), (2, 0)))) / 2


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
