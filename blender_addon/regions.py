# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that belong together on a body: one material, one vertex group, one island between seams.

Each function takes the object in either mode and returns a mask [F].
"""

from __future__ import annotations

import bpy
import numpy as np

from . import colors
from .files.errors import InputError
from .mesh_arrays import current_mesh, face_count, polygon_loops, read

MEMBER = 0.5
"""Weight from which a vertex counts as part of its group."""


def of_material(obj: bpy.types.Object, slot: int) -> np.ndarray:
    """Faces of a material slot; those under the cloak count for the material they had before."""
    with current_mesh(obj) as mesh:
        return colors.own_slots_of(obj, mesh) == slot


def of_vertex_group(obj: bpy.types.Object, group: int) -> np.ndarray:
    """Faces whose corners all weigh at least a half in a vertex group."""
    with current_mesh(obj) as mesh:
        counts, loops = polygon_loops(mesh)
        member = np.zeros(len(mesh.vertices), bool)
        for index, vertex in enumerate(mesh.vertices):
            for entry in vertex.groups:
                if entry.group == group:
                    member[index] = entry.weight >= MEMBER
    return np.minimum.reduceat(member[loops], np.cumsum(counts) - counts)


def of_seam_islands(obj: bpy.types.Object, start: np.ndarray) -> np.ndarray:
    """All faces that can be reached from the faces of `start` without crossing a seam."""
    islands = seam_islands(obj)
    return np.isin(islands, np.unique(islands[start]))


def seam_islands(obj: bpy.types.Object) -> np.ndarray:
    """[F] for each face the lowest face of its island: faces that share an edge which is no seam are in one."""
    with current_mesh(obj) as mesh:
        counts, _ = polygon_loops(mesh)
        edge = read(mesh.loops, "edge_index", dtype=np.int32)
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
