# SPDX-License-Identifier: GPL-3.0-or-later
"""One logo across several objects: the body and clothing that has a logo of the same name.

An export numbers the faces of all objects through, the body's first. Its record says which numbers are whose, so that
trained colours find their garments again.
"""

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from ..blender import colors
from ..blender.evaluated import read_surface
from ..blender.faces import logo_mask
from ..blender.mesh_arrays import box_of, face_count, read, require_object_mode, to_world, topology
from ..files.errors import InputError
from ..session import session
from ..ui.window import show_progress
from .objects import below


def armature_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """The armature that deforms or carries the object."""
    carries = obj.parent is not None and obj.parent.type == "ARMATURE"
    return obj.find_armature() or (obj.parent if carries else None)


@dataclass(frozen=True)
class Garment:
    """A piece of clothing that wears the logo too."""

    object: str
    first: int  # number of its first face in the export
    faces: int
    topology: str


SURFACES = ("CURVE", "CURVES", "FONT", "META", "POINTCLOUD", "SURFACE", "VOLUME", "GREASEPENCIL", "GPENCIL")
"""Types of objects that show something and are no meshes."""
BESIDE, LARGER = 0.5, 1.5
"""A mesh without parent or armature is worn if this share of its box lies in the body's, and it is not much larger."""


def worn_by(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """What the camera sees beside the body: the one answer for training, judging, films and figures.

    Visible meshes that are the body's children, share its armature, or lie on it, without the garments that the user
    left out.
    """
    return [o for o in wearable(obj) if not o.cloak.left_out]


def wearable(obj: bpy.types.Object, meshes: bool = True) -> list[bpy.types.Object]:
    """List the worn objects, with the ones that the user left out; or what lies there and is no mesh.

    The camera does not see the latter: hair, text, instances.
    """
    seen = [o for o in session.kept(on_body, obj) if o.visible_get() and (o.type == "MESH") == meshes]
    return sorted(seen, key=lambda o: o.name)


def on_body(obj: bpy.types.Object, among: set | None) -> set:
    """Every object with a surface, among some (None for all), that is tied to the body or lies on it; seen or not."""
    objects = bpy.context.view_layer.objects if among is None else list(among)
    armature, own = armature_of(obj), below(obj, among)
    # A copy of the body lies where the body does, and is not worn by it.
    copy_of = lambda o: o.type == "MESH" and len(o.data.polygons) == len(obj.data.polygons)
    worn = {o for o in objects_near(objects, box_of(obj)) if not copy_of(o)}
    if armature is not None:  # what has another one belongs to another body, wherever that stands
        worn = {o for o in worn if armature_of(o) in (None, armature)}
        worn.update(o for o in objects if armature_of(o) == armature)
    of_copies = {o for o in worn if any(map(copy_of, _parents(o)))}
    shows = lambda o: len(o.data.polygons) if o.type == "MESH" else o.instance_type == "COLLECTION"
    return {o for o in own | worn - of_copies - {obj} if o.type in SURFACES or shows(o)}


def _parents(obj: bpy.types.Object) -> list[bpy.types.Object]:
    return [obj.parent, *_parents(obj.parent)] if obj.parent is not None else []


def pieces_of(obj: bpy.types.Object, garments: list[Garment]) -> list[bpy.types.Object]:
    """The objects that wear a run's garments: of what this body wears, those with their faces.

    Names decide between pieces of equal faces alone: those of a copied or appended character are others'.
    """
    worn, own, pieces = session.kept(on_body, obj), below(obj, None), []
    for garment in garments:
        same_faces = lambda o, g=garment: o.type == "MESH" and face_count(o) == g.faces and topology(o) == g.topology
        alike = [o for o in worn if o not in pieces and same_faces(o)]
        if not alike:
            raise InputError(
                f"'{obj.name}' wears no '{garment.object}' with the faces of the export: bring it back, or undo its "
                "change, or export and train again"
            )
        pieces.append(min(alike, key=lambda o: (o not in own, o.name != garment.object, o.name)))
        require_object_mode(pieces[-1], f"Leave {{mode}} to see the colours on '{pieces[-1].name}'")
    return pieces


def objects_near(objects: bpy.types.bpy_prop_collection | list, box: np.ndarray) -> list[bpy.types.Object]:
    """The objects that lie on a body by their boxes in the world, and are not much larger; the body's own [2, 3].

    In one pass of numpy: Python takes a tenth of a millisecond for each object of a scene.
    """
    if isinstance(objects, list):
        corners = np.float32([np.array(o.bound_box) for o in objects])
        matrices = np.float32([o.matrix_world.transposed() for o in objects])
    else:
        corners, matrices = read(objects, "bound_box", 24), read(objects, "matrix_world", 16)
    corners, matrices = corners.reshape(-1, 8, 3), matrices.reshape(-1, 4, 4)  # matrices of columns
    first, last = corners[:, 0].copy(), corners[:, 6].copy()  # the lowest and the highest corner
    for index in np.flatnonzero((first == last).all(1)).tolist():  # perhaps an instance of a collection
        collection = objects[index].instance_collection
        if boxes := [box_of(o) for o in collection.all_objects if o.type != "EMPTY"] if collection else []:
            first[index] = np.min(boxes, axis=(0, 1)) - np.array(collection.instance_offset)
            last[index] = np.max(boxes, axis=(0, 1)) - np.array(collection.instance_offset)
    turn, extent = matrices[:, :3, :3], box[1] - box[0]
    middle = np.einsum("ni,nij->jn", (first + last) / 2, turn) + matrices[:, 3, :3].T
    # Half a box's extent along the axes of the world; a flat object gets a thickness, to have a volume to compare.
    half = np.einsum("ni,nij->jn", (last - first) / 2, np.abs(turn)) + 1e-4 * extent.max()
    fits, shared, largest = True, 1.0, np.maximum(np.maximum(half[0], half[1]), half[2])
    for axis in range(3):  # numpy takes ten times as long over the short axis of [n, 3]
        fits &= 2 * half[axis] <= LARGER * extent[axis]
        low = np.maximum(middle[axis] - half[axis], box[0][axis] - 0.05 * extent[axis])
        high = np.minimum(middle[axis] + half[axis], box[1][axis] + 0.05 * extent[axis])
        shared *= np.maximum(high - low, 0) / (2 * half[axis])
    fits &= (2 * largest >= 0.02 * extent.max()) & (shared > BESIDE)
    return [objects[index] for index in np.flatnonzero(fits).tolist()]


def is_dressed(obj: bpy.types.Object) -> bool:
    """Whether some faces of the body or of its clothing wear the cloak."""
    return any(map(colors.is_dressed, (obj, *worn_by(obj))))


def undress(obj: bpy.types.Object) -> None:
    """Give the faces of the body and of its clothing their own material back."""
    for worn in (obj, *worn_by(obj)):
        colors.undress(worn)
        colors.activate(worn, "")


def faces_over(context: bpy.types.Context, obj: bpy.types.Object, worn: bpy.types.Object, logo: str) -> np.ndarray:
    """Mask [F] of the faces of `worn` whose nearest place on the body lies on the logo.

    Both as they stand now; where modifiers make other faces, the mesh's own.
    """
    body, cloth = read_surface(context, obj), read_surface(context, worn)
    show_progress(0.3)
    on_logo = logo_mask(obj, logo)
    chosen = (body.own >= 0) & on_logo[np.maximum(body.own, 0)]
    low, high = body.centers[chosen].min(0), body.centers[chosen].max(0)
    places = cloth.centers + (cloth.middle - body.middle).astype(np.float32)
    margin = 0.1 * float(np.ptp(body.points, axis=0).max())
    near = np.flatnonzero(((places >= low - margin) & (places <= high + margin)).all(1))
    tree = BVHTree.FromObject(obj, context.evaluated_depsgraph_get())
    local = to_world(cloth.centers[near] + cloth.middle, np.linalg.inv(np.array(obj.matrix_world)))
    over = np.zeros(len(near), bool)
    for index, point in enumerate(local):
        over[index] = chosen[tree.find_nearest(point)[2]]
        if index % 10_000 == 0:
            show_progress(0.4 + 0.6 * index / len(near))
    return cloth.own_mask(near[over])
