# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator of step 5 that takes the cloak out of Blender."""

from __future__ import annotations

import bpy
from bpy.props import IntProperty

from ..blender import colors
from ..ui.operator import BodyOperator
from . import bake


class CLOAK_OT_bake(BodyOperator):
    """Bake the trained colours to an image and make a material of it that is an asset. Where the body has no UV map, \
or one with too little room, Cloak makes one of its own"""

    bl_label = "Bake to Image"

    size: IntProperty(name="Size", description="Texels along each side", default=2048, min=16, max=8192)

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        reason = BodyOperator.needs(context)
        if reason or colors.CLOAK in context.object.data.color_attributes:
            return reason
        return "Train, or load colours, first"

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        self.show(0.3)
        done = bake.bake(obj, self.size)
        material = bake.baked_material(done.image, done.uv_map)
        faces = f"{done.off:,} of {len(obj.data.polygons):,} faces are off by more than 4/255"
        made = f"Image and material '{material.name}' on UV map '{done.uv_map}'; {faces}"
        return made if done.off_before is None else f"{made} ({done.off_before:,} on the body's own map)"
