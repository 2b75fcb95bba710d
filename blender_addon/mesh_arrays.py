# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's data as numpy arrays, read and written in one place.

P polygons (faces), V vertices, T triangles, C corners of all polygons one after the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np


def sync(obj: bpy.types.Object) -> None:
    """Bring the mesh up to date with Edit Mode: `foreach_get` reads stale data otherwise."""
    if obj.mode == "EDIT":
        obj.update_from_editmode()


def read(items: bpy.types.bpy_prop_collection, name: str, width: int = 1, dtype: type = np.float32) -> np.ndarray:
    """One property of every item: [n], or [n, width] for a property of several numbers."""
    values = np.empty(width * len(items), dtype)
    items.foreach_get(name, values)
    return values.reshape(-1, width) if width > 1 else values


def write_attribute(mesh: bpy.types.Mesh, name: str, kind: str, values: np.ndarray) -> None:
    """Set the face attribute `name`, made where there is none; `kind` is "BOOLEAN", "INT" or "FLOAT"."""
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, kind, "FACE")
    attribute.data.foreach_set("value", np.ascontiguousarray(values))
    mesh.update_tag()


def polygon_loops(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The polygons' vertex loops: corner counts [P] int32 and vertex indices [C] int32."""
    corners = mesh.attributes.get(".corner_vert")
    if corners is not None and len(corners.data) == len(mesh.loops):
        vertices = read(corners.data, "value", dtype=np.int32)  # ten times as fast as through the loops
    else:
        vertices = read(mesh.loops, "vertex_index", dtype=np.int32)
    return corner_counts(mesh), vertices


def corner_counts(mesh: bpy.types.Mesh) -> np.ndarray:
    """[P] int32."""
    return read(mesh.polygons, "loop_total", dtype=np.int32)


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


def image_pixels(image: bpy.types.Image) -> np.ndarray:
    """[H, W, channels] float32 as stored, bottom row first."""
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], image.channels)
