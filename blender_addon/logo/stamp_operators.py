# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 2 that stamp a logo onto the body: placed by numbers, or by the mouse."""

import math
from pathlib import Path

import bpy
import numpy as np
from bpy.props import FloatVectorProperty
from mathutils import Vector

from ..blender.evaluated import joined, read_surface
from ..blender.mesh_arrays import triangle_areas
from ..body.garments import worn_by
from ..body.objects import require_upright, upright_reason
from ..files.errors import InputError
from ..ui import props
from ..ui.operator import BodyOperator
from ..ui.window import main_region, show_progress
from . import stamp
from .operators import take
from .overlay import ADDED, MOVES, Preview
from .stamp import Placed, Projection, front_projection, laid

PAPER_SHARE = 0.044  # of the body's area: 2,426 (letter G) and 2,427 (smiley) of the paper's 55,152 faces
SIZES = {
    **dict.fromkeys(("WHEELUPMOUSE", "NUMPAD_PLUS", "EQUAL"), 1.08),
    **dict.fromkeys(("WHEELDOWNMOUSE", "NUMPAD_MINUS", "MINUS"), 1 / 1.08),
}
"""Factor of the size for a click of the mouse wheel, or a key."""
HELP = "Move: place   Wheel, + -: size   R: rotate with the mouse   Click, Enter: stamp   Right click, Esc: cancel"


class StampOperator(BodyOperator):
    """Base: lays the stamp that is set onto the body and what it wears, and makes a logo of the faces it covers."""

    def lay(self, context: bpy.types.Context, obj: bpy.types.Object) -> bpy.types.PropertyGroup:
        """Read the body and the stamp; returns the settings."""
        require_upright(obj)
        settings = context.scene.cloak
        if settings.stamp_kind == "TEXT":
            ink, self._name = stamp.text_stamp(settings.stamp_text), settings.stamp_text.strip()
        elif settings.stamp_kind == "IMAGE":
            ink, self._name = stamp.image_stamp(settings.stamp_image), Path(settings.stamp_image.name).stem
        else:
            ink, self._name = stamp.smiley_stamp(), "Smiley"
        self._obj, self._worn = obj, worn_by(obj)  # clothing takes the faces that it covers
        self._placed = Placed(joined([read_surface(context, one) for one in (obj, *self._worn)]), ink)
        show_progress(0.6)  # a body with subdivision takes seconds
        return settings

    def write(self, projection: Projection, add: bool) -> str:
        """Make the logo, or add to the active one; returns what to say."""
        mask = self._placed.own_mask(projection)
        show_progress(0.9)
        name = take(self._obj, mask, self._name, add, self._worn)
        return f"Logo '{name}': {int(mask.sum()):,} faces under the stamp"


class CLOAK_OT_logo_stamp(StampOperator, label="Stamp", told_by="add"):
    """Project the stamp onto the body's front and make a logo of the faces it covers"""

    add: props.switch("Add", "Add to the active logo instead of making a new one")

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        settings = self.lay(context, obj)
        place = (settings.stamp_size, settings.stamp_center, settings.stamp_offset)
        return self.write(front_projection(obj, *place, self._placed.aspect), self.add)


class CLOAK_OT_stamp_drag(StampOperator, label="Place Stamp", needs=upright_reason, told_by="kind"):
    """Drag the stamp over the body, see what it takes, click to stamp. The mouse wheel resizes, R rotates"""

    kind: props.choice(
        "Stamp",
        "What is stamped",
        ("SETTINGS", "As Set", "The text, picture or smiley that is chosen under Stamp"),
        ("LETTER", "Paper's Letter", "The letter G with the paper's share of the body"),
        ("SMILEY", "Paper's Smiley", "The smiley with the paper's share of the body"),
    )
    place: FloatVectorProperty(name="Place", description="Middle of the stamp on the body", subtype="TRANSLATION")
    direction: FloatVectorProperty(
        name="Direction", description="Into the body, from where it is stamped", subtype="DIRECTION", default=(0, 1, 0)
    )
    height: props.number("Height", "Height of the stamp", 0.3, min=1e-6, subtype="DISTANCE")
    angle: props.number("Angle", "Turns the stamp against the clock", subtype="ANGLE")
    add: props.switch("Add", "Add to the active logo instead of making a new one")

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        self.lay(context, obj)
        return self.write(self._projection(), self.add)

    def lay(self, context: bpy.types.Context, obj: bpy.types.Object) -> bpy.types.PropertyGroup:
        settings = context.scene.cloak
        if self.kind == "LETTER":
            settings.stamp_kind, settings.stamp_text = "TEXT", "G"
        elif self.kind == "SMILEY":
            settings.stamp_kind = "SMILEY"
        return super().lay(context, obj)

    def _projection(self) -> Projection:
        place, direction = np.array(self.place), np.array(self.direction)
        return laid(place, direction, self.height, self._placed.aspect, self.angle)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.attempt(self._begin, context, event)

    def _begin(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if context.area is None or context.area.type != "VIEW_3D":
            raise InputError("No 3D viewport to stamp in")
        settings = self.lay(context, context.object)
        self._area, self._region, self._turning = context.area, main_region(context.area), None
        surface, ink = self._placed.surface, self._placed.ink
        if self.kind != "SETTINGS":
            area = float(triangle_areas(surface.points, surface.corners).sum())
            self.height = math.sqrt(PAPER_SHARE * area / (ink.mean() * self._placed.aspect))
        else:
            self.height = settings.stamp_size * float(np.ptp(surface.points[:, 2]))
        self.angle = 0.0
        self._preview = Preview(surface, ADDED)
        self._preview.register()
        self._area.header_text_set(HELP)
        self._follow(event)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        pressed = event.value == "PRESS"
        if event.type in MOVES:
            self._follow(event)
        elif event.type in SIZES and pressed:
            self.height *= SIZES[event.type]
            self._show()
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
            mouse = Vector((event.mouse_x - self._region.x, event.mouse_y - self._region.y))
            view = (self._region, self._area.spaces.active.region_3d)
            hits, direction = self._placed.surface.under(*view, mouse)
            if len(hits):
                self.place, self.direction = Vector(hits[0]), direction
        self._show()

    def _show(self) -> None:
        self._preview.show(self._placed.faces(self._projection()), alone=True)
        self._area.tag_redraw()

    def _end(self, stamps: bool) -> set[str]:
        self._preview.unregister()
        self._area.header_text_set(None)
        self._area.tag_redraw()
        return self.attempt(self.write, self._projection(), self.add) if stamps else {"CANCELLED"}
