# SPDX-License-Identifier: GPL-3.0-or-later
"""Modifiers that give a mesh other faces: which of the mesh's own faces each evaluated face comes from.

A logo, its colours and its face ids belong to the mesh's own faces; what a camera sees are the evaluated ones. Blender
carries face attributes through Mirror, Subdivision Surface, Solidify, Array, most Geometry Nodes and others, so the own
face's number is sent along as one. Faces that share an own face (both halves of a mirrored body) share its colour, in
training as on the model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np

from . import mesh_arrays as arrays
from .faces import logo_names
from .mesh_arrays import current_mesh, evaluated_mesh, read

CARRIED = "cloak_carried_face"
"""Integer face attribute, for the time of an export: each own face's number, counted from 1."""
DEFORMS_ONLY = {
    "ARMATURE", "CAST", "CLOTH", "COLLISION", "CORRECTIVE_SMOOTH", "CURVE", "DATA_TRANSFER", "DISPLACE", "HOOK",
    "LAPLACIANDEFORM", "LAPLACIANSMOOTH", "LATTICE", "MESH_CACHE", "MESH_DEFORM", "NORMAL_EDIT", "SHRINKWRAP",
    "SIMPLE_DEFORM", "SMOOTH", "SOFT_BODY", "SURFACE", "SURFACE_DEFORM", "UV_PROJECT", "UV_WARP", "VERTEX_WEIGHT_EDIT",
    "VERTEX_WEIGHT_MIX", "VERTEX_WEIGHT_PROXIMITY", "VOLUME_DISPLACE", "WARP", "WAVE", "WEIGHTED_NORMAL",
}  # fmt: skip
"""Modifier types that never change the number or order of faces."""
LOSES_FACES = {"FLUID", "MESH_TO_VOLUME", "OCEAN", "REMESH", "SKIN", "VOLUME_TO_MESH"}
"""Modifier types that make a new mesh, whose faces come from none of the old."""


def keeps_faces(obj: bpy.types.Object, evaluated: bpy.types.Mesh) -> bool:
    """Whether the evaluated faces are the mesh's own, in number, order and corners."""
    with current_mesh(obj) as mesh:
        if len(evaluated.polygons) != len(mesh.polygons) or len(evaluated.vertices) != len(mesh.vertices):
            return False
        return all(map(np.array_equal, arrays.polygon_loops(evaluated), arrays.polygon_loops(mesh)))


def changes_faces(obj: bpy.types.Object, graph: bpy.types.Depsgraph) -> bool:
    """Whether the object's modifiers give it other faces now."""
    with evaluated_mesh(obj, graph) as (mesh, _):
        return not keeps_faces(obj, mesh)


@contextmanager
def numbered_faces(objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """During the block the objects' own faces have numbers, which `carried_faces` reads off the evaluated mesh."""
    for obj in objects:
        with arrays.object_mode(obj):
            arrays.write_attribute(obj.data, CARRIED, "INT", np.arange(1, len(obj.data.polygons) + 1, dtype=np.int32))
    try:
        yield
    finally:
        for obj in objects:
            with arrays.object_mode(obj):
                obj.data.attributes.remove(obj.data.attributes[CARRIED])
                obj.data.update_tag()


def carried_faces(obj: bpy.types.Object, evaluated: bpy.types.Mesh) -> np.ndarray | None:
    """[P] int: the own face that each evaluated face comes from, -1 for none; None where no number came through."""
    attribute = evaluated.attributes.get(CARRIED)
    if attribute is None or attribute.domain != "FACE" or attribute.data_type != "INT" or not len(attribute.data):
        return None
    own = read(attribute.data, "value", dtype=np.int32) - 1
    strange = (own < 0) | (own >= arrays.face_count(obj))
    return None if strange.all() else np.where(strange, -1, own)


def modifiers_reason(obj: bpy.types.Object) -> str:
    """Why the object's logos do not reach its evaluated faces; "" when they do. Cheap enough for every redraw.

    In Edit Mode, where Blender shows other modifiers, nothing is said.
    """
    logos = logo_names(obj.data) if obj.mode != "EDIT" else ()
    if not logos or not _face_changers(obj):
        return ""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    if len(evaluated.polygons) == len(obj.data.polygons):
        return ""
    found = (evaluated.attributes.get(name) for name in logos)
    return "" if any(a is not None and a.domain == "FACE" for a in found) else lost_reason(obj)


def lost_reason(obj: bpy.types.Object) -> str:
    """Which visible modifiers make faces that come from none of the mesh's own, and what to do."""
    changers = _face_changers(obj)
    certain = [m for m in changers if m.type in LOSES_FACES]
    names = [f"'{m.name}'" for m in certain or changers]
    if not names:
        return f"The faces of '{obj.name}' change when it is evaluated"
    which = "modifier " + names[0] if len(names) == 1 else "modifiers " + ", ".join(names)
    return (
        f"The {which} of '{obj.name}' makes new faces that come from none of the mesh's own, so a logo cannot follow: "
        "press Apply a Copy and make the logo there, or turn it off in the viewport"
    )


def _face_changers(obj: bpy.types.Object) -> list[bpy.types.Modifier]:
    return [m for m in obj.modifiers if m.show_viewport and m.type not in DEFORMS_ONLY]


def applied_copy(context: bpy.types.Context, obj: bpy.types.Object) -> bpy.types.Object:
    """A new object beside `obj` whose mesh has the face-changing modifiers applied; deforming ones stay modifiers.

    Shape keys end in their present mix. `obj` is hidden.
    """
    changers = {modifier.name for modifier in _face_changers(obj)}
    others = [m for m in obj.modifiers if m.name not in changers and m.show_viewport]
    for modifier in others:
        modifier.show_viewport = False
    try:
        graph = context.evaluated_depsgraph_get()
        mesh = bpy.data.meshes.new_from_object(obj.evaluated_get(graph), preserve_all_data_layers=True, depsgraph=graph)
    finally:
        for modifier in others:
            modifier.show_viewport = True
    copy = obj.copy()
    copy.data, copy.name = mesh, f"{obj.name} applied"
    mesh.name = copy.name
    for name in changers:
        copy.modifiers.remove(copy.modifiers[name])
    for collection in obj.users_collection:
        collection.objects.link(copy)
    obj.hide_set(True)
    arrays.choose(context, copy)
    return copy
