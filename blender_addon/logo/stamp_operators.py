# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator of step 2 that stamps a logo onto the body."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.props import EnumProperty

from ..blender import faces
from ..blender.surface import read_surface
from ..body.objects import require_upright
from ..files.errors import InputError
from ..properties import settings_of
from ..ui.operator import BodyOperator
from . import stamp
from .operators import active_logo
from .placing import Placed, Projection, front_projection, view_projection


class CLOAK_OT_logo_stamp(BodyOperator):
    """Project the stamp onto the body and make a logo of the faces it covers"""

    bl_label = "Stamp"

    target: EnumProperty(
        name="Target",
        description="Where the covered faces go",
        items=[("NEW", "New Logo", "Make a new logo"), ("ADD", "Active Logo", "Add to the active logo")],
    )

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        settings = settings_of(context)
        require_upright(obj)
        ink, name = ink_of(settings)
        self.show(0.3)  # a body with subdivision takes seconds
        placed = Placed(read_surface(context, obj), ink)
        if settings.stamp_from == "VIEW":
            projection = _from_view(context, settings.stamp_size, placed.aspect)
        else:
            place = (settings.stamp_size, settings.stamp_center, settings.stamp_offset)
            projection = front_projection(obj, *place, placed.aspect)
        mask = placed.own_mask(projection)
        if self.target == "ADD":
            name = active_logo(obj)
            faces.add_faces(obj, name, mask)
        else:
            name = faces.new_logo(obj, name, mask)
        obj.cloak.logo = name
        return f"Logo '{name}': {int(mask.sum()):,} faces under the stamp"


PAPER_SHARE = 0.044
"""Of the body's area: 2,426 (letter G) and 2,427 (smiley) of the paper's 55,152 faces."""
HALVINGS = 7


class CLOAK_OT_stamp_paper(BodyOperator):
    """Stamp the paper's letter G or smiley onto the chest, 4.4 % of the body's area as there"""

    bl_label = "Paper's Logo"

    kind: EnumProperty(
        name="Logo",
        description="Which of the paper's logos",
        items=[("TEXT", "Letter", "The letter G"), ("SMILEY", "Smiley", "A ring with two eyes and a mouth")],
    )

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        require_upright(obj)
        settings = settings_of(context)
        settings.stamp_kind, settings.stamp_text, settings.stamp_from = self.kind, "G", "FRONT"
        settings.stamp_center, settings.stamp_offset = 0.72, 0.0
        ink, name = ink_of(settings)
        areas, placed = faces.face_areas(obj), Placed(read_surface(context, obj), ink)
        low, high, share = 0.02, 1.0, 0.0
        for step in range(HALVINGS):
            settings.stamp_size = (low + high) / 2
            projection = front_projection(obj, settings.stamp_size, settings.stamp_center, 0.0, placed.aspect)
            mask = placed.own_mask(projection)
            share = float(areas[mask].sum() / areas.sum())
            low, high = (settings.stamp_size, high) if share < PAPER_SHARE else (low, settings.stamp_size)
            self.show((step + 1) / HALVINGS)
        obj.cloak.logo = faces.new_logo(obj, name, mask)
        return f"Logo '{obj.cloak.logo}': {int(mask.sum()):,} faces, {share:.1%} of the area"


def ink_of(settings: bpy.types.PropertyGroup) -> tuple[np.ndarray, str]:
    """The stamp that is set, and a name for the logo it makes."""
    if settings.stamp_kind == "TEXT":
        return stamp.text_stamp(settings.stamp_text), settings.stamp_text.strip()
    if settings.stamp_kind == "IMAGE":
        return stamp.image_stamp(settings.stamp_image), Path(settings.stamp_image.name).stem
    return stamp.smiley_stamp(), "Smiley"


def _from_view(context: bpy.types.Context, size: float, aspect: float) -> Projection:
    area = context.area if context.area and context.area.type == "VIEW_3D" else None
    if area is None and context.window_manager.windows:
        screens = (window.screen for window in context.window_manager.windows)
        area = next((a for screen in screens for a in screen.areas if a.type == "VIEW_3D"), None)
    if area is None or area.spaces.active.region_3d is None:
        raise InputError("No 3D viewport to stamp from: choose From > Front")
    region = next(r for r in area.regions if r.type == "WINDOW")
    return view_projection(region, area.spaces.active.region_3d, size, aspect)
