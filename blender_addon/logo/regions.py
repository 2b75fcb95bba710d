# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that belong together on a body: a material, a vertex group, a face set, an island between seams.

Each function takes the object in either mode and returns a mask [F].
"""

from __future__ import annotations

import bpy
import numpy as np

from ..blender import colors
from ..blender.mesh_arrays import bmesh_of, corner_edges, current_mesh, face_count, polygon_loops, read
from ..body.objects import ORIGINAL_FACE
from ..files.errors import InputError

MEMBER = 0.5
"""Weight from which a vertex counts as part of its group."""
MAX_SETS = 64
NOT_SETS = {"material_index", colors.OWN_MATERIAL, ORIGINAL_FACE}
"""Integer face attributes that Blender and Cloak keep for themselves."""


def of_material(obj: bpy.types.Object, slot: int) -> np.ndarray:
    """Faces of a material slot; those under the cloak count for the material they had before."""
    with current_mesh(obj) as mesh:
        return colors.own_slots_of(obj, mesh) == slot


def of_vertex_group(obj: bpy.types.Object, group: int) -> np.ndarray:
    """Faces whose corners all weigh at least a half in a vertex group."""
    with bmesh_of(obj) as bm:  # five times as fast as from the mesh
        layer = bm.verts.layers.deform.active
        weights = (vertex[layer].get(group, 0.0) if layer else 0.0 for vertex in bm.verts)
        member = np.fromiter(weights, np.float32, len(bm.verts)) >= MEMBER
    with current_mesh(obj) as mesh:
        counts, loops = polygon_loops(mesh)
    return np.minimum.reduceat(member[loops], np.cumsum(counts) - counts)


def is_face_set(attribute: bpy.types.Attribute) -> bool:
    """Whether a mesh attribute sorts faces by whole numbers, and is not kept by Blender or Cloak for themselves."""
    whole = attribute.data_type in ("INT", "INT8")
    return whole and attribute.domain == "FACE" and attribute.name not in NOT_SETS


def face_sets(obj: bpy.types.Object) -> list[tuple[str, int]]:
    """Names and values of the mesh's integer face attributes, such as sculpting's face sets; the first MAX_SETS each.

    They took the place of face maps, which Blender 4 no longer has.
    """
    with current_mesh(obj) as mesh:
        names = [attribute.name for attribute in mesh.attributes if is_face_set(attribute)]
        values = {name: np.unique(_integers(mesh, name)) for name in names}
    return [(name, int(value)) for name, found in values.items() for value in found[:MAX_SETS]]


def of_face_set(obj: bpy.types.Object, name: str, value: int) -> np.ndarray:
    """Faces that have a value of an integer face attribute."""
    with current_mesh(obj) as mesh:
        return _integers(mesh, name) == value


def _integers(mesh: bpy.types.Mesh, name: str) -> np.ndarray:
    return read(mesh.attributes[name].data, "value", dtype=np.int32)


def of_seam_islands(obj: bpy.types.Object, start: np.ndarray) -> np.ndarray:
    """All faces that can be reached from the faces of `start` without crossing a seam."""
    islands = seam_islands(obj)
    return np.isin(islands, np.unique(islands[start]))


def seam_islands(obj: bpy.types.Object) -> np.ndarray:
    """[F] for each face the lowest face of its island: faces that share an edge which is no seam are in one."""
    with current_mesh(obj) as mesh:
        counts, _ = polygon_loops(mesh)
        edge = corner_edges(mesh)
        inner = ~read(mesh.edges, "use_seam", dtype=bool)[edge]
    edge, face = edge[inner], np.repeat(np.arange(len(counts)), counts)[inner]
    order = np.argsort(edge, kind="stable")
    edge, face = edge[order], face[order]
    same = edge[1:] == edge[:-1]
    a, b = face[:-1][same], face[1:][same]
    label = np.arange(len(counts))
    while True:
        least = np.minimum(label[a], label[b])
        following = label.copy()
        for side in (a, b):  # also what the two were called until now: whole chains join at once
            np.minimum.at(following, side, least)
            np.minimum.at(following, label[side], least)
        following = following[following]
        if np.array_equal(following, label):
            return label
        label = following


def require_faces(obj: bpy.types.Object, mask: np.ndarray, what: str) -> np.ndarray:
    """The mask; `InputError` where it is empty."""
    if not mask.any():
        raise InputError(f"{what} of '{obj.name}' has no faces: choose another (of {face_count(obj):,} faces)")
    return mask
