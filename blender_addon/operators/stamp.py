# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator of step 2 that stamps a logo onto the body."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.props import EnumProperty

from .. import faces, stamp
from ..body import require_upright
from ..files.errors import InputError
from ..properties import settings_of
from .base import BodyOperator
from .logo import active_logo


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
        ink, name = _ink(settings)
        aspect = ink.shape[1] / ink.shape[0]
        if settings.stamp_from == "VIEW":
            projection = _from_view(context, settings.stamp_size, aspect)
        else:
            placed = (settings.stamp_size, settings.stamp_center, settings.stamp_offset)
            projection = stamp.front_projection(obj, *placed, aspect)
        mask = stamp.covered_faces(context, obj, ink, projection)
        if self.target == "ADD":
            name = active_logo(obj)
            faces.add_faces(obj, name, mask)
        else:
            name = faces.new_logo(obj, name, mask)
        obj.cloak.logo = name
        return f"Logo '{name}': {int(mask.sum()):,} faces under the stamp"


def _ink(settings: bpy.types.PropertyGroup) -> tuple[np.ndarray, str]:
    if settings.stamp_kind == "TEXT":
        return stamp.text_stamp(settings.stamp_text), settings.stamp_text.strip()
    if settings.stamp_kind == "IMAGE":
        return stamp.image_stamp(settings.stamp_image), Path(settings.stamp_image.name).stem
    return stamp.smiley_stamp(), "Smiley"


def _from_view(context: bpy.types.Context, size: float, aspect: float) -> stamp.Projection:
    area = context.area if context.area and context.area.type == "VIEW_3D" else None
    if area is None and context.window_manager.windows:
        screens = (window.screen for window in context.window_manager.windows)
        area = next((a for screen in screens for a in screen.areas if a.type == "VIEW_3D"), None)
    if area is None or area.spaces.active.region_3d is None:
        raise InputError("No 3D viewport to stamp from: choose From > Front")
    region = next(r for r in area.regions if r.type == "WINDOW")
    return stamp.view_projection(region, area.spaces.active.region_3d, size, aspect)


CLASSES = (CLOAK_OT_logo_stamp,)
