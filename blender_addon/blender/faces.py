# SPDX-License-Identifier: GPL-3.0-or-later
"""Logos: named sets of faces, stored as boolean face attributes of the mesh.

So they survive saving, subdivision and editing, and Blender's own attribute panel shows them too. Every function works
in Object Mode and in Edit Mode. A mask is a bool array [F], one entry per polygon.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path

import bmesh
import bpy
import numpy as np

from ..exchange.face_lists import read_face_list
from ..files.errors import InputError
from . import mesh_arrays as arrays
from .marks import free_name
from .mesh_arrays import topology

NOT_LOGOS = {"sharp_face", "freestyle_face"}  # boolean face attributes that Blender itself keeps


def is_logo(attribute: bpy.types.Attribute) -> bool:
    """Whether a mesh attribute is a logo: a boolean per face that is not Blender's own."""
    own = attribute.name.startswith(".") or attribute.name in NOT_LOGOS
    return attribute.domain == "FACE" and attribute.data_type == "BOOLEAN" and not own


def logo_names(mesh: bpy.types.Mesh) -> list[str]:
    """Names of the mesh's logos, in the mesh's order."""
    return [attribute.name for attribute in mesh.attributes if is_logo(attribute)]


def active_logo(obj: bpy.types.Object) -> str:
    """Name of the logo that is active in the list; `InputError` when the mesh has none."""
    names = logo_names(obj.data)
    if not names:
        raise InputError(f"'{obj.name}' has no logo: select faces in Edit Mode and press New from Selection")
    return obj.cloak.logo if obj.cloak.logo in names else names[0]


def logo_mask(obj: bpy.types.Object, logo: str) -> np.ndarray:
    """Read the mask [F] of a logo, or of several joined by "+"; names that the object does not have are skipped."""
    masks = [read_faces(obj, name) for name in _parts(obj, logo) if name in logo_names(obj.data)]
    return np.logical_or.reduce([np.zeros(arrays.face_count(obj), bool), *masks])


def _parts(obj: bpy.types.Object, logo: str) -> list[str]:
    return [logo] if logo in logo_names(obj.data) else [part.strip() for part in logo.split("+")]


def require_logo(obj: bpy.types.Object, name: str) -> np.ndarray:
    """Mask of a logo that exists on `obj` and has faces; several names may be joined by "+"."""
    for part in _parts(obj, name):
        if part not in logo_names(obj.data):
            if others := [o.name for o in bpy.data.objects if o.type == "MESH" and part in logo_names(o.data)]:
                raise InputError(
                    f"Logo '{part}' is on '{others[0]}', not on '{obj.name}': make '{others[0]}' the active object"
                )
            have = ", ".join(logo_names(obj.data)) or "none"
            raise InputError(
                f"'{obj.name}' has no logo '{part}' (it has: {have}): select faces in Edit Mode and press New from "
                "Selection"
            )
    mask = logo_mask(obj, name)
    if not mask.any():
        raise InputError(f"Logo '{name}' is empty: select faces in Edit Mode and press Assign")
    return mask


HAS_LAYERS = hasattr(bmesh.types.BMLayerAccessFace, "bool")
"""Blender before 4.4 gives Python no boolean layers in Edit Mode."""


def read_faces(obj: bpy.types.Object, name: str) -> np.ndarray:
    """Mask [F] of the logo `name`."""
    with arrays.current_mesh(obj) as mesh:
        return arrays.read(mesh.attributes[name].data, "value", dtype=bool)


def write_faces(obj: bpy.types.Object, name: str, mask: np.ndarray, where: np.ndarray | None = None) -> None:
    """Set the logo `name` to `mask`, making it where there is none; where given, in the faces of that mask alone."""
    if obj.mode == "EDIT" and HAS_LAYERS:  # without reading the mesh, which takes longer than to visit each face
        where = np.ones(len(mask), bool) if where is None else where
        bm = bmesh.from_edit_mesh(obj.data)
        layer = bm.faces.layers.bool.get(name) or bm.faces.layers.bool.new(name)
        for face, flag in zip(itertools.compress(bm.faces, where.tolist()), mask[where].tolist(), strict=True):
            face[layer] = flag
        bmesh.update_edit_mesh(obj.data, loop_triangles=False, destructive=False)
        arrays.edited(obj)
        return
    with arrays.object_mode(obj):
        mask = mask if where is None else np.where(where, mask, read_faces(obj, name))
        arrays.write_attribute(obj.data, name, "BOOLEAN", mask)


def read_selection(obj: bpy.types.Object) -> np.ndarray:
    """Mask [F] of the selected faces; in Edit Mode hidden faces are never selected."""
    with arrays.current_mesh(obj) as mesh:
        return arrays.selected(mesh, "polygons") & ~arrays.hidden_faces(mesh)


def select_faces(obj: bpy.types.Object, mask: np.ndarray) -> int:
    """Select exactly the visible faces of `mask`; returns how many of its faces are hidden and stay unselected."""
    with arrays.current_mesh(obj) as mesh:
        hidden = arrays.hidden_faces(mesh)
        visible = mask & ~hidden
        if obj.mode == "EDIT":
            _select_edited(obj, visible)
        else:
            corners = np.repeat(visible, arrays.corner_counts(mesh))
            mesh.polygons.foreach_set("select", visible)
            for items, of_corners in ((mesh.vertices, arrays.corner_vertices), (mesh.edges, arrays.corner_edges)):
                items.foreach_set("select", np.bincount(of_corners(mesh)[corners], minlength=len(items)) > 0)
            mesh.update_tag()
    return int((mask & hidden).sum())


def _select_edited(obj: bpy.types.Object, faces: np.ndarray) -> None:
    """Select faces in Edit Mode; only elements that change are visited, because Python visits each one."""
    bm = bmesh.from_edit_mesh(obj.data)
    kinds = ("vertices", "edges", "polygons")
    with arrays.current_mesh(obj) as mesh:
        chosen = [np.flatnonzero(arrays.selected(mesh, kind)) for kind in kinds]
    for elements, indices in zip((bm.verts, bm.edges, bm.faces), chosen, strict=True):
        elements.ensure_lookup_table()
        for index in indices.tolist():
            elements[index].select = False
    for index in np.flatnonzero(faces).tolist():
        bm.faces[index].select_set(True)
    bmesh.update_edit_mesh(obj.data, loop_triangles=False, destructive=False)
    arrays.edited(obj)


def new_logo(obj: bpy.types.Object, name: str, mask: np.ndarray, others: Sequence[bpy.types.Object] = ()) -> str:
    """Make a logo; returns its name, which gets a number where the wanted one is taken, also on `others`."""
    if not mask.any() and not others:
        raise InputError("No faces to take: select faces in Edit Mode (or stamp a picture) first")
    name = name.strip().lstrip(".") or "Logo"
    unique = f"{name} logo" if name in NOT_LOGOS else name
    for one in (obj, *others):
        unique = free_name(one, unique)
    write_faces(obj, unique, mask)
    return unique


def import_face_list(obj: bpy.types.Object, path: Path) -> str:
    """A new logo from a face list; checked against the mesh. Returns its name."""
    face_list = read_face_list(path)
    with arrays.current_mesh(obj) as mesh:  # one copy for both
        own, counts = topology(obj), arrays.corner_counts(mesh)
    if face_list.topology not in (None, own):
        raise InputError(
            f"{path}: made for topology {face_list.topology}, but '{obj.name}' has {own}: choose its own mesh"
        )
    if face_list.index_of == "triangle" and (counts != 3).any():
        raise InputError(f"{path}: counts triangles, but '{obj.name}' has larger faces: triangulate it first")
    if face_list.ids[-1] >= len(counts):
        raise InputError(f"{path}: face {face_list.ids[-1]} is beyond the {len(counts)} faces of '{obj.name}'")
    return new_logo(obj, path.stem, np.isin(np.arange(len(counts)), face_list.ids))


def face_areas(obj: bpy.types.Object) -> np.ndarray:
    """[F] areas in world space: sums over triangles, as the trainer counts them."""
    with arrays.current_mesh(obj) as mesh:
        points = arrays.to_world(arrays.vertex_points(mesh), np.array(obj.matrix_world))
        corners, face = arrays.mesh_triangles(mesh)
        return np.bincount(face, arrays.triangle_areas(points, corners), len(mesh.polygons))
