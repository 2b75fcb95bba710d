# SPDX-License-Identifier: GPL-3.0-or-later
"""One logo across several objects: the body and clothing that has a logo of the same name.

An export numbers the faces of all objects through, the body's first. Its record says which numbers are whose, so that
trained colours find their garments again.
"""

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from ..blender import colors
from ..blender.evaluated import read_surface
from ..blender.faces import logo_mask
from ..blender.mesh_arrays import box_of, to_world, topology
from ..files.errors import InputError


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


BESIDE, LARGER = 0.5, 1.5
"""A mesh without parent or armature is worn if this share of its box lies in the body's, and it is not much larger."""


def worn_by(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """What the camera sees beside the body: the one answer for training, judging, films and figures.

    Visible meshes that are the body's children, share its armature, or lie on it, without the garments that the user
    left out.
    """
    return [o for o in wearable(obj) if not o.cloak.left_out]


def wearable(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """List the worn objects, with the ones that the user left out."""
    armature, box, children = armature_of(obj), box_of(obj), set(obj.children_recursive)
    is_tied = lambda o: o in children or (armature is not None and armature_of(o) == armature)
    others = (o for o in bpy.context.view_layer.objects if o.type == "MESH" and o != obj and len(o.data.polygons))
    worn = (o for o in others if o.visible_get() and (is_tied(o) or _lies_on(o, obj, box)))
    return sorted(worn, key=lambda o: o.name)


def _lies_on(other: bpy.types.Object, obj: bpy.types.Object, box: np.ndarray) -> bool:
    """Whether a mesh that nothing ties to the body is worn by it. A copy of the body is not."""
    if len(other.data.polygons) == len(obj.data.polygons):
        return False
    low, high = box_of(other)
    size, extent = high - low, box[1] - box[0]
    if (size > LARGER * extent).any() or size.max() < 0.02 * extent.max():
        return False
    shared = np.minimum(high, box[1] + 0.05 * extent) - np.maximum(low, box[0] - 0.05 * extent)
    return bool((shared > 0).all() and np.prod(shared / np.maximum(size, 1e-9)) > BESIDE)


def is_dressed(obj: bpy.types.Object) -> bool:
    """Whether some faces of the body or of its clothing wear the cloak."""
    return any(map(colors.is_dressed, (obj, *worn_by(obj))))


def undress(obj: bpy.types.Object) -> None:
    """Give the faces of the body and of its clothing their own material back."""
    for worn in (obj, *worn_by(obj)):
        colors.undress(worn)
        if colors.OUTFIT in worn.data.color_attributes:
            colors.activate(worn, colors.OUTFIT)


def write_worn(garments: list[Garment], ids: np.ndarray, values: np.ndarray, dress: bool) -> None:
    """Write the garments' part of the colours [L, 3] of faces [L]; with `dress` also assign the cloak's material."""
    for obj, garment in [(_worn_object(g), g) for g in garments]:  # all of them are there, or nothing is written
        mine = (ids >= garment.first) & (ids < garment.first + garment.faces)
        local = ids[mine] - garment.first
        worn = colors.own_face_colors(obj)
        worn[local] = values[mine]
        colors.write_face_colors(obj, colors.CLOAK, worn)
        if dress:
            colors.dress(obj, local)
            colors.activate(obj, colors.CLOAK)


def _worn_object(garment: Garment) -> bpy.types.Object:
    obj = bpy.data.objects.get(garment.object)
    if obj is None or obj.type != "MESH":
        raise InputError(f"'{garment.object}' wore the logo and is gone or has another name: rename it back")
    if obj.mode == "EDIT":
        raise InputError(f"Leave Edit Mode (Tab) to see the colours on '{obj.name}'")
    if topology(obj) != garment.topology:
        raise InputError(f"'{obj.name}' changed since export: undo the change, or export and train again")
    return obj


def faces_over(
    context: bpy.types.Context, obj: bpy.types.Object, worn: bpy.types.Object, logo: str, show: Callable[[float], None]
) -> np.ndarray:
    """Mask [F] of the faces of `worn` whose nearest place on the body lies on the logo.

    Both as they stand now; where modifiers make other faces, the mesh's own.
    """
    body, cloth = read_surface(context, obj), read_surface(context, worn)
    show(0.3)
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
            show(0.4 + 0.6 * index / len(near))
    return cloth.own_mask(near[over])
