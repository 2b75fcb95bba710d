# SPDX-License-Identifier: GPL-3.0-or-later
"""The stamp that follows the mouse over the body."""

from __future__ import annotations

import math

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Vector

from ..blender import faces
from ..blender.mesh_arrays import current_mesh
from ..blender.surface import read_surface
from ..body.objects import require_upright
from ..body.reasons import upright_reason
from ..files.errors import InputError
from ..properties import settings_of
from ..ui.operator import BodyOperator
from .operators import active_logo
from .placing import Placed, Projection, area_of, laid
from .preview import ADDED, Preview
from .stamp_operators import PAPER_SHARE, ink_of

MOVES = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}
STEP = 1.08
"""Factor of the size for one click of the mouse wheel."""
HELP = "Move: place   Wheel, + -: size   R: rotate with the mouse   Click, Enter: stamp   Right click, Esc: cancel"


class CLOAK_OT_stamp_drag(BodyOperator):
    """Drag the stamp over the body, see what it takes, click to stamp. The mouse wheel resizes, R rotates"""

    bl_label = "Place Stamp"

    kind: EnumProperty(
        name="Stamp",
        description="What is stamped",
        items=[
            ("SETTINGS", "As Set", "The text, picture or smiley that is chosen under Stamp"),
            ("LETTER", "Paper's Letter", "The letter G with the paper's share of the body"),
            ("SMILEY", "Paper's Smiley", "The smiley with the paper's share of the body"),
        ],
    )
    place: FloatVectorProperty(name="Place", description="Middle of the stamp on the body", subtype="TRANSLATION")
    direction: FloatVectorProperty(
        name="Direction", description="Into the body, from where it is stamped", subtype="DIRECTION", default=(0, 1, 0)
    )
    height: FloatProperty(name="Height", description="Height of the stamp", default=0.3, min=1e-6, subtype="DISTANCE")
    angle: FloatProperty(name="Angle", description="Turns the stamp against the clock", subtype="ANGLE")
    add: BoolProperty(name="Add", description="Add to the active logo instead of making a new one")
    needs = staticmethod(upright_reason)

    # --- from numbers ---

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        self.show(0.3)
        self._prepare(context, obj)
        return self._write()

    def _prepare(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        require_upright(obj)
        settings = settings_of(context)
        if self.kind != "SETTINGS":
            settings.stamp_kind = "TEXT" if self.kind == "LETTER" else "SMILEY"
            settings.stamp_text = "G" if self.kind == "LETTER" else settings.stamp_text
        ink, self._name = ink_of(settings)
        self._obj, self._placed = obj, Placed(read_surface(context, obj), ink)

    def _projection(self) -> Projection:
        place, direction = np.array(self.place), np.array(self.direction)
        return laid(place, direction, self.height, self._placed.aspect, self.angle)

    def _write(self) -> str:
        mask = self._placed.own_mask(self._projection())
        obj = self._obj
        with current_mesh(obj):
            if self.add:
                name = active_logo(obj)
                faces.add_faces(obj, name, mask)
            else:
                name = faces.new_logo(obj, self._name, mask)
        obj.cloak.logo = name
        return f"Logo '{name}': {int(mask.sum()):,} faces under the stamp"

    # --- with the mouse ---

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.attempt(self._begin, context, event)

    def _begin(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        view = _view_of(context)
        if view is None:
            raise InputError("No 3D viewport to stamp in")
        self._prepare(context, context.object)
        self._area, self._region, self._turning = *view, None
        surface, ink = self._placed.surface, self._placed.ink
        if self.kind != "SETTINGS":
            self.height = math.sqrt(PAPER_SHARE * area_of(surface) / (ink.mean() * self._placed.aspect))
        else:
            self.height = settings_of(context).stamp_size * float(np.ptp(surface.points[:, 2]))
        self.angle = 0.0
        self._preview = Preview(surface, ADDED)
        self._preview.begin()
        self._area.header_text_set(HELP)
        self._follow(event)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        pressed = event.value == "PRESS"
        if event.type in MOVES:
            self._follow(event)
        elif event.type in {"WHEELUPMOUSE", "NUMPAD_PLUS", "EQUAL"} and pressed:
            self._resize(STEP)
        elif event.type in {"WHEELDOWNMOUSE", "NUMPAD_MINUS", "MINUS"} and pressed:
            self._resize(1 / STEP)
        elif event.type == "R" and pressed:
            self._turning = None if self._turning else (event.mouse_x, self.angle)
        elif event.type in {"LEFTMOUSE", "RET", "NUMPAD_ENTER"} and pressed:
            return self._end(True)
        elif event.type in {"ESC", "RIGHTMOUSE"}:
            return self._end(False)
        elif event.type == "MIDDLEMOUSE" or event.type.startswith(("NDOF", "TRACKPAD")):
            return {"PASS_THROUGH"}  # looking around
        return {"RUNNING_MODAL"}

    def _follow(self, event: bpy.types.Event) -> None:
        """The mouse turns the stamp, or takes it along over the body."""
        if self._turning:
            self.angle = self._turning[1] - (event.mouse_x - self._turning[0]) * math.radians(0.5)
        else:
            mouse = (event.mouse_x - self._region.x, event.mouse_y - self._region.y)
            view = (self._region, self._area.spaces.active.region_3d, mouse)
            origin, direction = region_2d_to_origin_3d(*view), region_2d_to_vector_3d(*view)
            hits = self._placed.surface.hits(np.array(origin), np.array(direction))
            if len(hits):
                self.place, self.direction = Vector(hits[0]), direction
        self._show()

    def _resize(self, factor: float) -> None:
        self.height *= factor
        self._show()

    def _show(self) -> None:
        self._preview.replace(self._placed.faces(self._projection()))
        self._area.tag_redraw()

    def _end(self, stamps: bool) -> set[str]:
        self._preview.end()
        self._area.header_text_set(None)
        self._area.tag_redraw()
        return self.attempt(self._write) if stamps else {"CANCELLED"}


def _view_of(context: bpy.types.Context) -> tuple[bpy.types.Area, bpy.types.Region] | None:
    """The 3D viewport that the button was pressed in, and its main region."""
    area = context.area if context.area and context.area.type == "VIEW_3D" else None
    region = next((region for region in area.regions if region.type == "WINDOW"), None) if area else None
    return (area, region) if region else None
