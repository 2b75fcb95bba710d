# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 2 that make a logo of what already belongs together: a material, a vertex group, a face set,
seam islands."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty

from ..blender import faces
from ..blender.mesh_arrays import current_mesh
from ..ui.operator import BodyOperator
from . import regions
from .operators import active_logo, selected_faces

_shown: dict[str, list[tuple[str, str, str]]] = {}
"""Blender keeps no copy of a menu's words: these lists must live on."""


def _menu(kind: str, names: list[str]) -> list[tuple[str, str, str]]:
    _shown[kind] = [(str(index), name, f"Faces of {name}") for index, name in enumerate(names)]
    return _shown[kind]


def _materials(self: bpy.types.Operator, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    obj = context.object if context else None
    return _menu("material", [slot.name or f"Slot {slot.slot_index + 1}" for slot in obj.material_slots] if obj else [])


def _groups(self: bpy.types.Operator, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    obj = context.object if context else None
    return _menu("group", [group.name for group in obj.vertex_groups] if obj else [])


class PickOperator(BodyOperator):
    """Base: `pick(obj)` returns a mask and a name for the logo."""

    add: BoolProperty(name="Add", description="Add to the active logo instead of making a new one")

    def pick(self, obj: bpy.types.Object) -> tuple[np.ndarray, str]:
        raise NotImplementedError

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        self.show(0.3)
        with current_mesh(obj):
            mask, name = self.pick(obj)
            regions.require_faces(obj, mask, f"'{name}'")
            if self.add:
                name = active_logo(obj)
                faces.add_faces(obj, name, mask)
            else:
                name = faces.new_logo(obj, name, mask)
        obj.cloak.logo = name
        return f"Logo '{name}': {int(mask.sum()):,} faces taken"


class CLOAK_OT_logo_from_material(PickOperator):
    """Make a logo of all faces of a material"""

    bl_label = "From Material"
    bl_property = "slot"

    slot: EnumProperty(name="Material", description="Whose faces to take", items=_materials)

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        return BodyOperator.needs(context) or ("" if context.object.material_slots else "The body has no materials")

    def pick(self, obj: bpy.types.Object) -> tuple[np.ndarray, str]:
        slot = int(self.slot)
        return regions.of_material(obj, slot), obj.material_slots[slot].name or f"Slot {slot + 1}"


class CLOAK_OT_logo_from_group(PickOperator):
    """Make a logo of the faces whose corners all weigh at least a half in a vertex group"""

    bl_label = "From Vertex Group"
    bl_property = "group"

    group: EnumProperty(name="Vertex Group", description="Whose faces to take", items=_groups)

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        return BodyOperator.needs(context) or ("" if context.object.vertex_groups else "The body has no vertex groups")

    def pick(self, obj: bpy.types.Object) -> tuple[np.ndarray, str]:
        group = int(self.group)
        return regions.of_vertex_group(obj, group), obj.vertex_groups[group].name


def _face_sets(self: bpy.types.Operator, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    obj = context.object if context else None
    sets = regions.face_sets(obj) if obj and obj.type == "MESH" else []
    _shown["face set"] = [
        (f"{value} {name}", _set_title(name, value), f"Faces whose '{name}' is {value}") for name, value in sets
    ]
    return _shown["face set"]


def _set_title(name: str, value: int) -> str:
    return f"Face Set {value}" if name == ".sculpt_face_set" else f"{name} {value}"


class CLOAK_OT_logo_from_face_set(PickOperator):
    """Make a logo of a sculpting face set, or of the faces that share a value of an integer face attribute"""

    bl_label = "From Face Set"
    bl_property = "face_set"

    face_set: EnumProperty(name="Face Set", description="Whose faces to take", items=_face_sets)

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        reason = BodyOperator.needs(context)
        if reason or any(regions.is_face_set(attribute) for attribute in context.object.data.attributes):
            return reason
        return "The body has no face sets (integer face attributes)"

    def pick(self, obj: bpy.types.Object) -> tuple[np.ndarray, str]:
        value, _, name = self.face_set.partition(" ")
        return regions.of_face_set(obj, name, int(value)), _set_title(name, int(value))


class CLOAK_OT_logo_from_island(PickOperator):
    """Make a logo of everything between the seams around the selected faces"""

    bl_label = "From Seam Island"

    def pick(self, obj: bpy.types.Object) -> tuple[np.ndarray, str]:
        return regions.of_seam_islands(obj, selected_faces(obj)), "Island"
