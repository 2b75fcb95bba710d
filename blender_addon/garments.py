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

from . import colors
from .body import topology
from .faces import logo_names, read_faces
from .files.errors import InputError
from .files.reading import read_json
from .poses import armature_of


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


def clothing_of(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Visible meshes worn by the body: its children, and what shares its armature."""
    armature = armature_of(obj)
    candidates = list(obj.children_recursive)
    if armature is not None:
        candidates += [o for o in bpy.context.view_layer.objects if o.type == "MESH" and armature_of(o) == armature]
    worn = {o for o in candidates if o.type == "MESH" and o != obj and o.visible_get() and len(o.data.polygons)}
    return sorted(worn, key=lambda o: o.name)


def also_wearing(obj: bpy.types.Object, logo: str) -> list[bpy.types.Object]:
    """Clothing that has a logo of this name too."""
    return [worn for worn in clothing_of(obj) if logo in logo_names(worn.data)]


def logo_mask(obj: bpy.types.Object, logo: str) -> np.ndarray:
    """Mask [F] of a logo, or of those joined by "+", as far as the object has them."""
    names = [logo] if logo in logo_names(obj.data) else [part.strip() for part in logo.split("+")]
    found = [read_faces(obj, name) for name in names if name in logo_names(obj.data)]
    return np.logical_or.reduce([np.zeros(len(obj.data.polygons), bool), *found])


def is_dressed(obj: bpy.types.Object) -> bool:
    """Whether some faces of the body or of its clothing wear the cloak."""
    return any(map(colors.is_dressed, (obj, *clothing_of(obj))))


def undress(obj: bpy.types.Object) -> None:
    """Give the faces of the body and of its clothing their own material back."""
    for worn in (obj, *clothing_of(obj)):
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
