# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator of step 5 that takes the cloak out of Blender."""

from __future__ import annotations

import bpy
from bpy.props import IntProperty

from .. import bake, colors
from ..cursor import progress_cursor
from .base import BodyOperator


class CLOAK_OT_bake(BodyOperator):
    """Bake the trained colours to an image on the body's UV map, and make a material of it that is an asset"""

    bl_label = "Bake to Image"

    size: IntProperty(name="Size", description="Texels along each side", default=2048, min=16, max=8192)

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        reason = BodyOperator.needs(context)
        if reason or colors.CLOAK in context.object.data.color_attributes:
            return reason
        return "Train, or load colours, first"

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        with progress_cursor(context):
            image, shared = bake.bake(obj, self.size)
            material = bake.baked_material(image)
        note = f"; {shared:.1%} of its texels belong to several faces, whose colours differ" if shared > 0.01 else ""
        return f"Image '{image.name}' and material asset '{material.name}', packed into the file{note}"


CLASSES = (CLOAK_OT_bake,)
