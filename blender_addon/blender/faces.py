# SPDX-License-Identifier: GPL-3.0-or-later
"""Logos: named sets of faces, stored as boolean face attributes of the mesh.

So they survive saving, subdivision and editing, and Blender's own attribute panel shows them too. Every function works
in Object Mode and in Edit Mode. A mask is a bool array [F], one entry per polygon.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

import bmesh
import bpy
import numpy as np

from ..body.objects import topology
from ..exchange.face_lists import read_face_list
from ..files.errors import InputError
from . import mesh_arrays as arrays
from .symmetry import nearest_within

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


def require_logo(obj: bpy.types.Object, name: str) -> np.ndarray:
    """Mask of a logo that exists on `obj` and has faces; several names may be joined by "+"."""
    names = [name] if name in logo_names(obj.data) else [part.strip() for part in name.split("+")]
    mask = np.zeros(0, bool)
    for part in names:
        if part not in logo_names(obj.data):
            raise InputError(_missing(obj, part))
        faces = read_faces(obj, part)
        mask = faces if not mask.size else mask | faces
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
"""Blender before 4.4 gives Python no boolean layers in Edit Mode; there, Edit Mode is left for a moment."""


@contextmanager
def _object_mode(obj: bpy.types.Object) -> Iterator[None]:
    """Object Mode during the block; selection and hiding come along."""
    editing = obj.mode == "EDIT"
    if editing:
        arrays.edited(obj)
        bpy.ops.object.mode_set(mode="OBJECT")
    try:
        yield
    finally:
        if editing:
            bpy.ops.object.mode_set(mode="EDIT")


def read_faces(obj: bpy.types.Object, name: str) -> np.ndarray:
    """Mask [F] of the logo `name`."""
    with arrays.current_mesh(obj) as mesh:
        return arrays.read(mesh.attributes[name].data, "value", dtype=bool)


def write_faces(obj: bpy.types.Object, name: str, mask: np.ndarray) -> None:
    """Set the logo `name` to `mask`, making it where there is none."""
    mesh = obj.data
    if obj.mode == "EDIT" and HAS_LAYERS:
        layers = bmesh.from_edit_mesh(mesh).faces.layers.bool
        old = read_faces(obj, name) if layers.get(name) else np.zeros(len(mask), bool)
        for flag in (True, False):
            _write_edited(obj, name, (mask != old) & (mask == flag), flag)
        return
    with _object_mode(obj):
        arrays.write_attribute(mesh, name, "BOOLEAN", mask)


def add_faces(obj: bpy.types.Object, name: str, mask: np.ndarray) -> None:
    """Add the faces of `mask` to the logo `name`."""
    if obj.mode == "EDIT" and HAS_LAYERS:
        _write_edited(obj, name, mask, True)
    else:
        write_faces(obj, name, read_faces(obj, name) | mask)


def remove_faces(obj: bpy.types.Object, name: str, mask: np.ndarray) -> None:
    """Take the faces of `mask` out of the logo `name`."""
    logo = read_faces(obj, name)
    if obj.mode == "EDIT" and HAS_LAYERS:
        _write_edited(obj, name, mask & logo, False)
    else:
        write_faces(obj, name, logo & ~mask)


def _write_edited(obj: bpy.types.Object, name: str, mask: np.ndarray, flag: bool) -> None:
    """Set the flag of a mask's faces alone: Python takes each face by itself."""
    if not mask.any() and name in obj.data.attributes:
        return
    bm = bmesh.from_edit_mesh(obj.data)
    layer = bm.faces.layers.bool.get(name) or bm.faces.layers.bool.new(name)
    for face in itertools.compress(bm.faces, mask.tolist()):
        face[layer] = flag
    bmesh.update_edit_mesh(obj.data, loop_triangles=False, destructive=False)
    arrays.edited(obj)


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
    """Only what is selected now, or will be, is touched: Python takes each element by itself."""
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
    if obj.mode == "EDIT" and HAS_LAYERS:
        layers = bmesh.from_edit_mesh(obj.data).faces.layers.bool
        layers.remove(layers[name])
        bmesh.update_edit_mesh(obj.data, loop_triangles=False, destructive=False)
        arrays.edited(obj)
        return
    with _object_mode(obj):
        obj.data.attributes.remove(obj.data.attributes[name])


def grow(obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
    """The faces of `mask` and all that share a corner with them."""
    with arrays.current_mesh(obj) as now:
        loop_total, loop_vertices = arrays.polygon_loops(now)
        touched = np.zeros(len(now.vertices), bool)
    touched[loop_vertices[np.repeat(mask, loop_total)]] = True
    return _any_corner(touched[loop_vertices], loop_total)


def shrink(obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
    """The faces of `mask` that share no corner with a face outside it."""
    return ~grow(obj, ~mask)


def _any_corner(corners: np.ndarray, loop_total: np.ndarray) -> np.ndarray:
    face_of_corner = np.repeat(np.arange(len(loop_total)), loop_total)
    return np.bincount(face_of_corner, corners, len(loop_total)) > 0


def mirror(obj: bpy.types.Object, mask: np.ndarray) -> tuple[np.ndarray, int]:
    """The faces opposite those of `mask` across the object's X = 0 plane, and how many have no opposite.

    Opposite is the face whose centre lies nearest to the mirrored centre, within a quarter of its own size.
    """
    with arrays.current_mesh(obj) as mesh:
        centers, areas = (
            arrays.face_centers(arrays.vertex_points(mesh), *arrays.polygon_loops(mesh)),
            arrays.read(mesh.polygons, "area"),
        )
    ids = np.flatnonzero(mask)
    reach = np.maximum(0.25 * np.sqrt(areas[ids]), 1e-9)
    opposite = nearest_within(centers, centers[ids] * np.float32([-1, 1, 1]), reach)
    mirrored = np.zeros(len(centers), bool)
    mirrored[opposite[opposite >= 0]] = True
    return mirrored, int((opposite < 0).sum())


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


# --- figures ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LogoStats:
    """What the panel says about a logo. Areas in square metres of the object's rest shape, scaled by its transform."""

    faces: int
    hidden: int
    area: float
    whole_area: float
    """Of the body's surface."""
    projected_area: float
    """Of the faces turned to the front, as seen from there (occlusion aside)."""
    whole_projected_area: float
    """The same figure for the whole body."""
    covered: tuple[tuple[str, float], ...] = ()
    """Pieces that do not wear the logo and cover some of it from the front: their names, and the share of it."""

    @property
    def area_share(self) -> float:
        """Of the body's surface, 0 to 1."""
        return self.area / max(self.whole_area, 1e-12)

    @property
    def projected_share(self) -> float:
        """Of the body as seen from the front, 0 to 1."""
        return self.projected_area / max(self.whole_projected_area, 1e-12)

    def __add__(self, other: LogoStats) -> LogoStats:
        """Of two objects that wear the logo together."""
        return LogoStats(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


def logo_stats(obj: bpy.types.Object, mask: np.ndarray) -> LogoStats:
    """Counts and areas of a logo."""
    with arrays.current_mesh(obj) as mesh:
        vectors, polygon = _area_vectors(mesh, obj)
        hidden = arrays.hidden_faces(mesh)
    areas = np.bincount(polygon, np.linalg.norm(vectors, axis=1), len(mask))
    # The front looks along +y, so front faces have normals along -y.
    frontal = np.maximum(np.bincount(polygon, -vectors[:, 1], len(mask)), 0)
    square = bpy.context.scene.unit_settings.scale_length**2
    sums = (values.sum() * square for values in (areas[mask], areas, frontal[mask], frontal))
    return LogoStats(int(mask.sum()), int((mask & hidden).sum()), *map(float, sums))


def face_areas(obj: bpy.types.Object) -> np.ndarray:
    """[F] areas in world space: sums over triangles, as the trainer counts them."""
    with arrays.current_mesh(obj) as mesh:
        vectors, polygon = _area_vectors(mesh, obj)
        return np.bincount(polygon, np.linalg.norm(vectors, axis=1), len(mesh.polygons))


def _area_vectors(mesh: bpy.types.Mesh, obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Each triangle's normal times its area in world space, [T, 3], and the face it is part of, [T]."""
    points = arrays.to_world(arrays.vertex_points(mesh), np.array(obj.matrix_world))
    points -= points.mean(0)  # so that half the digits are enough, wherever the body stands
    return arrays.triangle_vectors(mesh, points.astype(np.float32))
