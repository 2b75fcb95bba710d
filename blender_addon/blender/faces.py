# SPDX-License-Identifier: GPL-3.0-or-later
"""Logos: named sets of faces, stored as boolean face attributes of the mesh.

So they survive saving, subdivision and editing, and Blender's own attribute panel shows them too. Every function works
in Object Mode and in Edit Mode. A mask is a bool array [F], one entry per polygon.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Euler
from mathutils.kdtree import KDTree

from ..exchange.face_lists import read_face_list
from ..files.errors import InputError
from . import mesh_arrays as arrays
from .mesh_arrays import topology

NOT_LOGOS = {"sharp_face", "freestyle_face"}
"""Boolean face attributes that Blender itself keeps."""


def is_logo(attribute: bpy.types.Attribute) -> bool:
    """Whether a mesh attribute is a logo: a boolean per face that is not Blender's own."""
    return (
        attribute.domain == "FACE"
        and attribute.data_type == "BOOLEAN"
        and not attribute.name.startswith(".")
        and attribute.name not in NOT_LOGOS
    )


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
    found = [read_faces(obj, name) for name in _parts(obj, logo) if name in logo_names(obj.data)]
    return np.logical_or.reduce([np.zeros(arrays.face_count(obj), bool), *found])


def _parts(obj: bpy.types.Object, logo: str) -> list[str]:
    return [logo] if logo in logo_names(obj.data) else [part.strip() for part in logo.split("+")]


def require_logo(obj: bpy.types.Object, name: str) -> np.ndarray:
    """Mask of a logo that exists on `obj` and has faces; several names may be joined by "+"."""
    for part in _parts(obj, name):
        if part not in logo_names(obj.data):
            raise InputError(_missing(obj, part))
    mask = logo_mask(obj, name)
    if not mask.any():
        raise InputError(f"Logo '{name}' is empty: select faces in Edit Mode and press Assign")
    return mask


def _missing(obj: bpy.types.Object, name: str) -> str:
    others = [o.name for o in bpy.data.objects if o.type == "MESH" and o != obj and name in logo_names(o.data)]
    if others:
        return f"Logo '{name}' is on '{others[0]}', not on '{obj.name}': make '{others[0]}' the active object"
    have = ", ".join(logo_names(obj.data)) or "none"
    return f"'{obj.name}' has no logo '{name}' (it has: {have}): select faces in Edit Mode and press New from Selection"


# --- reading and writing, in both modes ------------------------------------------------------------------------------


HAS_LAYERS = hasattr(bmesh.types.BMLayerAccessFace, "bool")
"""Blender before 4.4 gives Python no boolean layers in Edit Mode."""


def read_faces(obj: bpy.types.Object, name: str) -> np.ndarray:
    """Mask [F] of the logo `name`."""
    with arrays.current_mesh(obj) as mesh:
        return arrays.read(mesh.attributes[name].data, "value", dtype=bool)


def write_faces(obj: bpy.types.Object, name: str, mask: np.ndarray) -> None:
    """Set the logo `name` to `mask`, making it where there is none."""
    if obj.mode == "EDIT" and HAS_LAYERS:
        _write_edited(obj, name, mask)
        return
    with arrays.object_mode(obj):
        arrays.write_attribute(obj.data, name, "BOOLEAN", mask)


def _write_edited(obj: bpy.types.Object, name: str, mask: np.ndarray) -> None:
    """Set the flags of the faces that change alone: Python visits each, and leaving Edit Mode takes longer."""
    bm = bmesh.from_edit_mesh(obj.data)
    known = bm.faces.layers.bool.get(name)
    changed = mask != read_faces(obj, name) if known else mask
    layer = known or bm.faces.layers.bool.new(name)
    for face, flag in zip(itertools.compress(bm.faces, changed.tolist()), mask[changed].tolist(), strict=True):
        face[layer] = flag
    bmesh.update_edit_mesh(obj.data, loop_triangles=False, destructive=False)
    arrays.edited(obj)


def add_faces(obj: bpy.types.Object, name: str, mask: np.ndarray) -> None:
    """Add the faces of `mask` to the logo `name`."""
    write_faces(obj, name, read_faces(obj, name) | mask)


def remove_faces(obj: bpy.types.Object, name: str, mask: np.ndarray) -> None:
    """Take the faces of `mask` out of the logo `name`."""
    write_faces(obj, name, read_faces(obj, name) & ~mask)


def read_selection(obj: bpy.types.Object) -> np.ndarray:
    """Mask [F] of the selected faces; in Edit Mode hidden faces are never selected."""
    with arrays.current_mesh(obj) as mesh:
        return arrays.selected(mesh, "polygons") & ~arrays.hidden_faces(mesh)


def read_hidden(obj: bpy.types.Object) -> np.ndarray:
    """Mask [F] of faces hidden in Edit Mode."""
    with arrays.current_mesh(obj) as mesh:
        return arrays.hidden_faces(mesh)


def select_faces(obj: bpy.types.Object, mask: np.ndarray) -> int:
    """Select exactly the visible faces of `mask`; returns how many of its faces are hidden and stay unselected."""
    with arrays.current_mesh(obj) as mesh:
        hidden = read_hidden(obj)
        visible = mask & ~hidden
        if obj.mode == "EDIT":
            _select_edited(obj, visible)
        else:
            vertices, edges = _elements_of(mesh, visible)
            mesh.polygons.foreach_set("select", visible)
            mesh.vertices.foreach_set("select", vertices)
            mesh.edges.foreach_set("select", edges)
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


def _elements_of(mesh: bpy.types.Mesh, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masks of the vertices and edges that border the faces of a mask."""
    loop_total, loop_vertices = arrays.polygon_loops(mesh)
    loop_edges = arrays.corner_edges(mesh)
    corners = np.repeat(faces, loop_total)
    vertices, edges = np.zeros(len(mesh.vertices), bool), np.zeros(len(mesh.edges), bool)
    vertices[loop_vertices[corners]] = True
    edges[loop_edges[corners]] = True
    return vertices, edges


# --- making and changing logos ---------------------------------------------------------------------------------------


def new_logo(obj: bpy.types.Object, name: str, mask: np.ndarray) -> str:
    """Make a logo; returns its name, which gets a number where the wanted one is taken."""
    if not mask.any():
        raise InputError("No faces to take: select faces in Edit Mode (or stamp a picture) first")
    name = name.strip().lstrip(".") or "Logo"
    taken = {attribute.name for attribute in obj.data.attributes} | NOT_LOGOS
    taken |= {group.name for group in obj.vertex_groups}  # Blender keeps one set of names for both
    unique, number = name, 1
    while unique in taken:
        unique, number = f"{name}.{number:03d}", number + 1
    write_faces(obj, unique, mask)
    return unique


def remove_logo(obj: bpy.types.Object, name: str) -> None:
    """Take the logo off the mesh; its faces stay as they are."""
    with arrays.object_mode(obj):
        obj.data.attributes.remove(obj.data.attributes[name])


def grow(obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
    """The faces of `mask` and all that share a corner with them."""
    with arrays.current_mesh(obj) as mesh:
        counts, loops = arrays.polygon_loops(mesh)
        touched = np.zeros(len(mesh.vertices), bool)
    touched[loops[np.repeat(mask, counts)]] = True
    return np.logical_or.reduceat(touched[loops], np.cumsum(counts) - counts)


def shrink(obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
    """The faces of `mask` that share no corner with a face outside it."""
    return ~grow(obj, ~mask)


def mirror(obj: bpy.types.Object, mask: np.ndarray) -> tuple[np.ndarray, int]:
    """The faces opposite those of `mask` across the object's X = 0 plane, and how many have no opposite.

    Opposite is the face whose centre lies nearest to the mirrored centre, within a quarter of its own size.
    """
    with arrays.current_mesh(obj) as mesh:
        centers = arrays.face_centers(arrays.vertex_points(mesh), *arrays.polygon_loops(mesh))
        areas = arrays.read(mesh.polygons, "area")
    ids = np.flatnonzero(mask)
    reach = np.maximum(0.25 * np.sqrt(areas[ids]), 1e-9)
    opposite = nearest_within(centers, centers[ids] * np.float32([-1, 1, 1]), reach)
    mirrored = np.zeros(len(centers), bool)
    mirrored[opposite[opposite >= 0]] = True
    return mirrored, int((opposite < 0).sum())


def nearest_within(points: np.ndarray, queries: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """[Q] index of the point [N, 3] nearest to each query [Q, 3] within its own reach [Q]; -1 where there is none."""
    # Blender's tree takes quadratic time where many coordinates are equal, as on a regular mesh: turned, none are.
    margin = reach.max(initial=0.0)
    low, high = queries.min(0, initial=np.inf) - margin, queries.max(0, initial=-np.inf) + margin
    near = np.flatnonzero(((points >= low) & (points <= high)).all(1))
    if not len(near):
        return np.full(len(queries), -1)
    turn = np.array(Euler((0.5, 0.7, 1.1)).to_matrix())
    tree = KDTree(len(near))
    for index, point in zip(near.tolist(), (points[near] @ turn).tolist(), strict=True):
        tree.insert(point, index)
    tree.balance()
    found = [tree.find(query) for query in (queries @ turn).tolist()]
    return np.array([index if away <= most else -1 for (_, index, away), most in zip(found, reach, strict=True)], int)


# --- face lists ----------------------------------------------------------------------------------------------------


def import_face_list(obj: bpy.types.Object, path: Path) -> str:
    """A new logo from a face list; checked against the mesh. Returns its name."""
    face_list = read_face_list(path)
    own = topology(obj)
    if face_list.topology not in (None, own):
        raise InputError(
            f"{path}: made for topology {face_list.topology}, but '{obj.name}' has {own}: choose its own mesh"
        )
    with arrays.current_mesh(obj) as mesh:
        counts = arrays.corner_counts(mesh)
    count = len(counts)
    if face_list.index_of == "triangle" and (counts != 3).any():
        raise InputError(f"{path}: counts triangles, but '{obj.name}' has larger faces: triangulate it first")
    if face_list.ids[-1] >= count:
        raise InputError(f"{path}: face {face_list.ids[-1]} is beyond the {count} faces of '{obj.name}'")
    mask = np.zeros(count, bool)
    mask[face_list.ids] = True
    return new_logo(obj, path.stem, mask)


def face_areas(obj: bpy.types.Object) -> np.ndarray:
    """[F] areas in world space: sums over triangles, as the trainer counts them."""
    with arrays.current_mesh(obj) as mesh:
        points = arrays.to_world(arrays.vertex_points(mesh), np.array(obj.matrix_world))
        corners, face = arrays.mesh_triangles(mesh)
        return np.bincount(face, arrays.triangle_areas(points, corners), len(mesh.polygons))
