# SPDX-License-Identifier: GPL-3.0-or-later
"""One logo across several objects: the body and clothing that has a logo of the same name.

An export numbers the faces of all objects through, the body's first. Its record says which numbers are whose, so that
trained colours find their garments again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from ..blender import colors
from ..blender.faces import logo_names, read_faces
from ..blender.mesh_arrays import box_of, to_world
from ..blender.surface import read_surface
from ..files.errors import InputError
from ..files.reading import read_json
from .objects import topology


def armature_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """The armature that deforms or carries the object."""
    found = obj.find_armature()
    if found is None and obj.parent is not None and obj.parent.type == "ARMATURE":
        found = obj.parent
    return found


@dataclass(frozen=True)
class Garment:
    """A piece of clothing that wears the logo too."""

    object: str
    first: int
    """Number of its first face in the export."""
    faces: int
    topology: str


def read_garments(record: Path) -> list[Garment]:
    """What an export's record says; none for one that was written before there were any."""
    found = read_json(record).get("garments", []) if record.exists() else []
    try:
        return [Garment(str(g["object"]), int(g["first"]), int(g["faces"]), str(g["topology"])) for g in found]
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{record}: not the record of an export") from None


BESIDE, LARGER = 0.5, 1.5
"""What nothing ties to the body counts as worn when so much of its box lies in the body's, and it is no larger."""


def worn_by(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """What the camera sees beside the body: the one answer for training, judging, films and figures.

    Visible meshes that are the body's children, share its armature, or lie on it, without the garments that the user
    left out.
    """
    return [o for o in wearable(obj) if not o.cloak.left_out]


def wearable(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """The same, with the garments that the user left out."""
    armature, box = armature_of(obj), box_of(obj)
    children = set(obj.children_recursive)
    return sorted(
        (
            o
            for o in bpy.context.view_layer.objects
            if o.type == "MESH"
            and o != obj
            and len(o.data.polygons)
            and o.visible_get()
            and (o in children or (armature is not None and armature_of(o) == armature) or _lies_on(o, obj, box))
        ),
        key=lambda o: o.name,
    )


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


def also_wearing(obj: bpy.types.Object, logo: str) -> list[bpy.types.Object]:
    """Clothing that has a logo of this name too."""
    return [worn for worn in worn_by(obj) if logo in logo_names(worn.data)]


def logo_mask(obj: bpy.types.Object, logo: str) -> np.ndarray:
    """Mask [F] of a logo, or of those joined by "+", as far as the object has them."""
    names = [logo] if logo in logo_names(obj.data) else [part.strip() for part in logo.split("+")]
    found = [read_faces(obj, name) for name in names if name in logo_names(obj.data)]
    return np.logical_or.reduce([np.zeros(len(obj.data.polygons), bool), *found])


def is_dressed(obj: bpy.types.Object) -> bool:
    """Whether some faces of the body or of its clothing wear the cloak."""
    return any(map(colors.is_dressed, (obj, *worn_by(obj))))


def undress(obj: bpy.types.Object) -> None:
    """Give the faces of the body and of its clothing their own material back."""
    for worn in (obj, *worn_by(obj)):
        colors.undress(worn)
        if colors.OUTFIT in worn.data.color_attributes:
            colors.activate(worn, colors.OUTFIT)


class WornColors:
    """Where the colours of a run go, beside the body: checked once, written often."""

    def __init__(self, garments: list[Garment], face_ids: np.ndarray) -> None:
        self._garments, self._ids = garments, face_ids

    def on_body(self, body_faces: int) -> np.ndarray:
        """Mask [L] of the faces that are the body's own."""
        return self._ids < body_faces if self._garments else np.ones(len(self._ids), bool)

    def write(self, values: np.ndarray, dress: bool) -> None:
        """Colours [L, 3] onto the garments; with `dress` their faces get the cloak's material. All or nothing."""
        for obj, garment in [(_worn_object(g), g) for g in self._garments]:
            mine = (self._ids >= garment.first) & (self._ids < garment.first + garment.faces)
            local = self._ids[mine] - garment.first
            colors.write_face_colors(obj, colors.CLOAK, colors.cloak_colors(obj, local, values[mine]))
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


def faces_over(context: bpy.types.Context, obj: bpy.types.Object, worn: bpy.types.Object, logo: str) -> np.ndarray:
    """Mask [F] of the faces of `worn` whose nearest place on the body lies on the logo.

    Both as they stand now; where modifiers make other faces, the mesh's own.
    """
    body, cloth = read_surface(context, obj), read_surface(context, worn)
    on_logo = logo_mask(obj, logo)
    own = np.arange(len(body.centers)) if body.own is None else body.own
    chosen = (own >= 0) & on_logo[np.maximum(own, 0)]
    low, high = body.centers[chosen].min(0), body.centers[chosen].max(0)
    places = cloth.centers + (cloth.middle - body.middle).astype(np.float32)
    margin = 0.1 * float(np.ptp(body.points, axis=0).max())
    near = np.flatnonzero(((places >= low - margin) & (places <= high + margin)).all(1))
    tree = BVHTree.FromObject(obj, context.evaluated_depsgraph_get())
    local = to_world(cloth.centers[near] + cloth.middle, np.linalg.inv(np.array(obj.matrix_world)))
    over = [place for place, point in zip(near.tolist(), local, strict=True) if chosen[tree.find_nearest(point)[2]]]
    return cloth.own_mask(np.array(over, np.int64))
