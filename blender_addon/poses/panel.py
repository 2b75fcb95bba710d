# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of step 3: the poses to train on."""

import bpy

from ..blender.evaluated import modifiers_reason
from ..body.objects import active_body, body_reason
from ..ui.bases import CloakPanel, wrapped
from .export import export_summary, poses_reason
from .poses import lying_warning


class CLOAK_PT_poses(CloakPanel, label="3. Poses", closed=True, unfinished=poses_reason):
    """Step 3: the poses to train on"""

    def draw_header(self, context: bpy.types.Context) -> None:
        """Show an error in the header too: the panel is closed by default."""
        super().draw_header(context)
        if not body_reason(context) and self.unfinished(context):
            self.layout.label(icon="ERROR")

    def draw(self, context: bpy.types.Context) -> None:
        no_body = body_reason(context)
        column = self.gate(context, no_body)
        settings = context.scene.cloak
        column.prop(settings, "pose_source")
        if settings.pose_source == "RANGE":
            pair = column.column(align=True)
            pair.prop(settings, "frame_start")
            pair.prop(settings, "frame_end", text="End")
        if settings.pose_source != "CURRENT":
            column.prop(settings, "frame_step", text="Step")
        if no_body:
            return
        if reason := poses_reason(context):
            wrapped(column, context, reason, icon="ERROR")
            if modifiers_reason(active_body(context)):
                column.operator("cloak.apply_copy")
        else:
            wrapped(column, context, export_summary(context), icon="EXPORT")
            if lying_warning(active_body(context)):
                wrapped(column, context, lying_warning(active_body(context)), icon="ERROR")
