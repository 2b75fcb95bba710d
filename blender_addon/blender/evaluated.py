# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated meshes: which of the mesh's own faces each evaluated face comes from, and where a ray meets them.

A logo, its colours and its face ids belong to the mesh's own faces; what a camera sees are the evaluated ones. Blender
carries face attributes through Mirror, Subdivision Surface, Solidify, Array, most Geometry Nodes and others, so the own
face's number is sent along as one. Faces that share an own face (both halves of a mirrored body) share its colour, in
training as on the model.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace

import bpy
import numpy as np
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Vector
from mathutils.geometry import closest_point_on_tri, intersect_ray_tri

from ..files.errors import InputError
from . import mesh_arrays as arrays
from .faces import logo_names
from .marks import CARRIED, PREFIX, layer_name, make_layer, remove_layer
from .mesh_arrays import current_mesh, evaluated_mesh, read

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
        same_loops = map(np.array_equal, arrays.polygon_loops(evaluated), arrays.polygon_loops(mesh))
        return len(evaluated.vertices) == len(mesh.vertices) and all(same_loops)


def changes_faces(obj: bpy.types.Object, graph: bpy.types.Depsgraph) -> bool:
    """Whether the object's modifiers give it other faces now."""
    with evaluated_mesh(obj, graph) as (mesh, _):
        return not keeps_faces(obj, mesh)


@contextmanager
def numbered_faces(objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """During the block the objects' own faces have numbers, which `carried_faces` reads off the evaluated mesh."""
    for obj in objects:
        with arrays.object_mode(obj):
            numbers = np.arange(1, len(obj.data.polygons) + 1, dtype=np.int32)
            make_layer(obj, CARRIED).data.foreach_set("value", numbers)
            obj.data.update_tag()
    try:
        yield
    finally:
        for obj in objects:
            with arrays.object_mode(obj):
                remove_layer(obj.data, CARRIED)
                obj.data.update_tag()


def carried_faces(obj: bpy.types.Object, evaluated: bpy.types.Mesh) -> np.ndarray:
    """[P] int: the own face of each evaluated face, -1 for none. Raises `InputError` where no number came through."""
    attribute = evaluated.attributes.get(layer_name(obj.data, CARRIED))
    if attribute is None or attribute.domain != "FACE" or attribute.data_type != "INT" or not len(attribute.data):
        raise InputError(lost_reason(obj))
    own = read(attribute.data, "value", dtype=np.int32) - 1
    strange = (own < 0) | (own >= arrays.face_count(obj))
    if strange.all():
        raise InputError(lost_reason(obj))
    return np.where(strange, -1, own)


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
    attributes = (evaluated.attributes.get(name) for name in logos)
    return "" if any(a is not None and a.domain == "FACE" for a in attributes) else lost_reason(obj)


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
    for key in [key for key in obj.data.keys() if key.startswith(PREFIX)]:  # noqa: SIM118
        mesh[key] = obj.data[key]  # our marks: Blender leaves custom properties behind
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


@dataclass(frozen=True)
class Surface:
    """A body's faces at one moment, in arrays that answer quickly what a ray hits and what lies around.

    Read once when a stroke begins; no tree: a pass over hundreds of thousands of faces takes numpy milliseconds. Points
    that come in and go out are in world space; inside, coordinates are float32 relative to `middle`, so that they are
    exact anywhere. P evaluated faces, F faces of the mesh itself.
    """

    middle: np.ndarray  # [3] float64, in world space
    points: np.ndarray  # [V, 3] vertices
    centers: np.ndarray  # [P, 3]; one axis after the other in memory, so that a pass over them is quick
    normals: np.ndarray  # [P, 3], of any length
    reach_squared: np.ndarray  # [P] from each centre to its farthest corner, and a little more; squared
    shown: np.ndarray  # [P] bool: not hidden
    corners: np.ndarray  # [T, 3] vertices of all triangles
    face: np.ndarray  # [T] the face of each triangle
    own: np.ndarray  # [P] the mesh's own face that each evaluated face comes from, -1 for none
    own_count: int  # F

    def triangles(self, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [n, 3] of the triangles of some faces, and the face of each [n]."""
        chosen = np.zeros(len(self.centers), bool)
        chosen[faces] = True
        chosen = chosen[self.face]
        return self.corners[chosen], self.face[chosen]

    def hits(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """[n, 3] where a ray meets shown faces, the nearest first."""
        start = np.asarray(origin, np.float64) - self.middle
        ray = np.asarray(direction, np.float64) / np.linalg.norm(direction)
        offset = self.centers - start.astype(np.float32)
        along = offset @ ray.astype(np.float32)
        aside = np.einsum("ij,ij->i", offset, offset) - along * along
        near = np.flatnonzero((aside <= self.reach_squared) & self.shown)
        near = near[along[near] > -np.sqrt(self.reach_squared[near])]
        corners = self.points[self.triangles(near)[0]].tolist()
        met = (intersect_ray_tri(*map(Vector, points), ray, start) for points in corners)
        distance = np.array([(np.array(place) - start) @ ray for place in met if place is not None])
        return self.middle + start + np.sort(distance[distance > 0])[:, None] * ray

    def under(self, region: bpy.types.Region, view: bpy.types.RegionView3D, mouse: Vector) -> tuple[np.ndarray, Vector]:
        """`hits` of the ray through a pixel of a viewport, and the ray's direction."""
        direction = region_2d_to_vector_3d(region, view, mouse)
        return self.hits(np.array(region_2d_to_origin_3d(region, view, mouse)), np.array(direction)), direction

    def around(self, place: np.ndarray, radius: float) -> np.ndarray:
        """The faces whose centres lie within a radius of a place on the surface, and that look to its side; [n]."""
        point = (place - self.middle).astype(np.float32)
        offset = self.centers.T - point[:, None]
        squared = np.where(self.shown, (offset * offset).sum(0), np.float32(np.inf))
        if not self.shown.any():
            return np.zeros(0, np.int64)
        touched = int(np.argmin(squared))  # where no face is: the one with the nearest centre
        triangles, face = self.triangles(np.flatnonzero(squared <= self.reach_squared))
        if len(face):
            nearest = [closest_point_on_tri(Vector(point), *map(Vector, t)) for t in self.points[triangles].tolist()]
            touched = int(face[np.argmin(_squared(np.array(nearest) - point))])
        near = np.flatnonzero(squared <= radius**2)
        near = near[self.normals[near] @ self.normals[touched] > 0]
        beyond = squared[touched] > max(radius**2, float(self.reach_squared[touched]))
        return near if beyond else np.union1d(near, [touched])

    def own_mask(self, faces: np.ndarray) -> np.ndarray:
        """Mask [F] of the mesh's own faces that some evaluated faces come from."""
        mask = np.zeros(self.own_count, bool)
        own = self.own[faces]
        mask[own[own >= 0]] = True
        return mask


def _squared(vectors: np.ndarray) -> np.ndarray:
    return np.einsum("...j,...j->...", vectors, vectors)


def joined(surfaces: Sequence[Surface]) -> Surface:
    """Several surfaces as one: their evaluated faces, and their meshes' own ones, numbered through."""
    middle, parts = surfaces[0].middle, []
    vertices = faces = own_faces = 0
    for one in surfaces:
        away = (one.middle - middle).astype(np.float32)
        moved = {"points": one.points + away, "centers": one.centers + away, "corners": one.corners + vertices}
        own = np.where(one.own < 0, -1, one.own + own_faces)
        parts.append(replace(one, **moved, face=one.face + faces, own=own))
        vertices += len(one.points)
        faces += len(one.centers)
        own_faces += one.own_count
    names = [field.name for field in fields(Surface) if field.name not in ("middle", "own_count")]
    arrays_by_name = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    arrays_by_name["centers"] = np.asfortranarray(arrays_by_name["centers"])
    return Surface(middle=middle, own_count=own_faces, **arrays_by_name)


def read_surface(context: bpy.types.Context, obj: bpy.types.Object) -> Surface:
    """The body as it is seen now: posed, and with its modifiers' faces where they come from its own."""
    with arrays.evaluated_mesh(obj, context.evaluated_depsgraph_get()) as (mesh, matrix):
        if len(mesh.polygons) == arrays.face_count(obj):
            return _surface(obj, mesh, matrix, np.arange(len(mesh.polygons)))
    with numbered_faces([obj]), arrays.evaluated_mesh(obj, context.evaluated_depsgraph_get()) as (mesh, matrix):
        return _surface(obj, mesh, matrix, carried_faces(obj, mesh))


def _surface(obj: bpy.types.Object, mesh: bpy.types.Mesh, matrix: np.ndarray, own: np.ndarray) -> Surface:
    placed = arrays.to_world(arrays.vertex_points(mesh), matrix)
    middle = placed.mean(0)
    points = (placed - middle).astype(np.float32)
    corners, face = arrays.mesh_triangles(mesh)
    counts, loops = np.bincount(face, minlength=len(own)) + 2, arrays.corner_vertices(mesh)  # n-gons: n - 2 triangles
    centers = (arrays.to_world(arrays.read(mesh.polygons, "center", 3), matrix) - middle).astype(np.float32)
    normals = arrays.read(mesh.polygon_normals, "vector", 3) @ np.linalg.inv(matrix[:3, :3]).astype(np.float32)
    away = _squared(points[loops] - np.repeat(centers, counts, axis=0))
    reach = 1.001 * np.maximum.reduceat(away, np.cumsum(counts) - counts) + np.float32(1e-12)
    shown = ~arrays.hidden_faces(mesh)
    centers = np.asfortranarray(centers)
    return Surface(middle, points, centers, normals, reach, shown, corners, face, own, arrays.face_count(obj))
