# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 2 that take what belongs together: a material, a face set."""

from collections.abc import Callable

import bpy
import numpy as np
from bpy.props import EnumProperty

from ..blender import colors
from ..blender.marks import our_names
from ..blender.mesh_arrays import current_mesh, read
from ..body.objects import body_reason
from ..files.errors import InputError
from ..ui import props
from ..ui.operator import BodyOperator
from .operators import take

Items = list[tuple[str, str, str]]  # of a menu: value, name, description
MAX_SETS, TITLES = 64, {".sculpt_face_set": "Face Set"}


def _menu(find: Callable[[bpy.types.Object], Items]) -> Callable[[object, bpy.types.Context | None], Items]:
    """A menu of what is found on the active mesh."""
    kept: Items = []  # Blender keeps no copy of a menu's words: they must live on

    def items(_: object, context: bpy.types.Context | None) -> Items:
        obj = context.object if context else None
        kept[:] = find(obj) if obj and obj.type == "MESH" else []
        return kept

    return items


def materials(obj: bpy.types.Object) -> Items:
    """The object's material slots."""
    names = [slot.name or f"Slot {index + 1}" for index, slot in enumerate(obj.material_slots)]
    return [(str(index), name, f"Faces of {name}") for index, name in enumerate(names)]


def face_sets(obj: bpy.types.Object) -> Items:
    """Values of the mesh's integer face attributes, such as sculpting's face sets; the first MAX_SETS of each.

    They took the place of face maps, which Blender 4 no longer has.
    """
    found: Items = []
    with current_mesh(obj) as mesh:
        for name in [attribute.name for attribute in mesh.attributes if is_face_set(obj, attribute)]:
            title = TITLES.get(name, name)
            values = np.unique(_integers(mesh, name))[:MAX_SETS].tolist()
            found += [(f"{value} {name}", f"{title} {value}", f"Faces whose '{name}' is {value}") for value in values]
    return found


class PickOperator(BodyOperator):
    """Base: `pick(obj, mesh)` returns a mask of the object's current mesh, and a name for the logo.

    has: whether an object has something to pick. lacks: what to say where it has not.
    """

    def __init_subclass__(cls, label: str, has: Callable, lacks: str) -> None:
        reason = lambda context: body_reason(context) or ("" if has(context.object) else lacks)
        super().__init_subclass__(label=label, needs=reason)

    add: props.switch("Add", "Add to the active logo instead of making a new one")

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        with current_mesh(obj) as mesh:
            mask, name = self.pick(obj, mesh)
            if not mask.any():
                raise InputError(f"'{name}' of '{obj.name}' has no faces: choose another (of {len(mask):,} faces)")
            name = take(obj, mask, name, self.add)
        return f"Logo '{name}': {int(mask.sum()):,} faces taken"


class CLOAK_OT_logo_from_material(
    PickOperator, label="From Material", has=lambda obj: len(obj.material_slots), lacks="The body has no materials"
):
    """Make a logo of all faces of a material"""

    bl_property = "slot"

    slot: EnumProperty(name="Material", description="Whose faces to take", items=_menu(materials))

    def pick(self, obj: bpy.types.Object, mesh: bpy.types.Mesh) -> tuple[np.ndarray, str]:
        slot = int(self.slot)  # faces under the cloak count for the material they had before
        return colors.own_material_slots(obj, mesh) == slot, materials(obj)[slot][1]


class CLOAK_OT_logo_from_face_set(
    PickOperator,
    label="From Face Set",
    has=lambda obj: any(is_face_set(obj, attribute) for attribute in obj.data.attributes),
    lacks="The body has no face sets (integer face attributes)",
):
    """Make a logo of a sculpting face set, or of the faces that share a value of an integer face attribute"""

    bl_property = "face_set"

    face_set: EnumProperty(name="Face Set", description="Whose faces to take", items=_menu(face_sets))

    def pick(self, obj: bpy.types.Object, mesh: bpy.types.Mesh) -> tuple[np.ndarray, str]:
        value, _, name = self.face_set.partition(" ")
        return _integers(mesh, name) == int(value), f"{TITLES.get(name, name)} {value}"


def is_face_set(obj: bpy.types.Object, attribute: bpy.types.Attribute) -> bool:
    """Whether an attribute sorts an object's faces by whole numbers, and is not kept by Blender or Cloak themselves."""
    whole = attribute.data_type in ("INT", "INT8") and attribute.domain == "FACE"
    return whole and attribute.name not in {colors.SLOTS, *our_names(obj.data)}


def _integers(mesh: bpy.types.Mesh, name: str) -> np.ndarray:
    return read(mesh.attributes[name].data, "value", dtype=np.int32)
