# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of step 2: the faces that get trained colours."""

import bpy

from ..blender import faces
from ..blender.colors import shows
from ..blender.marks import HEAT, HEATMAP, layer_name
from ..body.objects import active_body, body_reason, logo_reason
from ..translations import said
from ..ui.bases import CloakPanel, figure, settings_column, wrapped
from . import overlay
from .overlay import PAINT

AREA = "Faces of the logo, and their share of the body's whole surface, as it stands now"
PROJECTED = (
    "What a camera in front sees of the logo: its area on the picture plane, and its share of the outline. What "
    "the body itself or a piece over it hides does not count"
)


class CLOAK_UL_logos(bpy.types.UIList):
    """The mesh's logos: its boolean face attributes"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        layout.prop(item, "name", text="", emboss=False, icon="FACESEL")

    def filter_items(self, context, data, property) -> tuple[list[int], list[int]]:
        return [self.bitflag_filter_item if faces.is_logo(a) else 0 for a in getattr(data, property)], []


class CLOAK_PT_logo(CloakPanel, label="2. Logo", unfinished=logo_reason):
    """Step 2: the faces that get trained colours"""

    def draw(self, context: bpy.types.Context) -> None:
        reason = body_reason(context)
        column = self.gate(context, reason)
        if reason:
            return
        obj, row = active_body(context), column.row()
        row.template_list("CLOAK_UL_logos", "", obj.data, "attributes", obj.cloak, "logo_index", rows=2)
        side = row.column(align=True)
        side.operator("cloak.logo_new", text="", icon="ADD")
        side.operator("cloak.logo_remove", text="", icon="REMOVE")
        column.operator("wm.tool_set_by_id", text="Paint with a Brush", icon="BRUSH_DATA").name = PAINT
        row = column.row(align=True)
        for name in ("assign", "unassign", "select"):
            row.operator(f"cloak.logo_{name}")
        if logo_reason(context):
            column.operator("cloak.logo_stamp", text="Stamp New Logo", icon="SORTALPHA").add = False
        self._stats(column, obj)
        column.prop(context.scene.cloak, "tint")

    def _stats(self, column: bpy.types.UILayout, obj: bpy.types.Object) -> None:
        stats = overlay.active_stats(obj)
        if stats is None:
            return
        lines = column.column(align=True)
        lines.use_property_split = False
        figure(lines, f"{stats.faces:,} faces, {stats.area_share:.1%} of the area", AREA, "FACESEL")
        share = stats.projected_area / max(stats.whole_projected_area, 1e-12)
        figure(lines, f"From the front: {stats.projected_area:.3f} m², {share:.1%}", PROJECTED)
        if not stats.faces:
            lines.label(text="Empty: select faces and press Assign", icon="ERROR")
        for name, share in stats.covered:
            wrapped(lines, bpy.context, f"{name} covers {share:.0%} of the logo", icon="ERROR")
            lines.operator("cloak.logo_onto", text="Put the Logo on It").garment = name
            lines.prop(bpy.data.objects[name].cloak, "left_out", text="Leave It Out", toggle=True)
        if stats.hidden:
            lines.label(text=said(f"{stats.hidden:,} faces are hidden (Alt H shows them)"), icon="HIDE_ON")


class CLOAK_PT_regions(CloakPanel, label="More Ways to a Logo", inside="logo"):
    """Logos of what belongs together already, and what changes a logo as a whole"""

    def draw(self, context: bpy.types.Context) -> None:
        column = settings_column(self.layout)
        column.enabled = not body_reason(context)
        row = column.row(align=True)
        row.operator_menu_enum("cloak.logo_from_material", "slot", text="Material")
        row.operator_menu_enum("cloak.logo_from_face_set", "face_set", text="Face Set")
        row = column.row(align=True)
        row.operator("cloak.logo_export")
        row.operator("cloak.logo_import", text="Import")


class CLOAK_PT_stamp(CloakPanel, label="Stamp", inside="logo"):
    """A logo from a text, a picture or a smiley"""

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.cloak
        column = settings_column(self.layout)
        column.enabled = not body_reason(context)
        box = column.column(align=True)
        box.row(align=True).prop(settings, "stamp_kind", expand=True)
        if settings.stamp_kind == "TEXT":
            box.prop(settings, "stamp_text")
        elif settings.stamp_kind == "IMAGE":
            box.template_ID(settings, "stamp_image", open="image.open")
        for name in ("stamp_size", "stamp_center", "stamp_offset"):
            box.prop(settings, name)
        drag = column.column(align=True)
        drag.operator("cloak.stamp_drag", text="Drag onto the Body", icon="VIEW_PAN").kind = "SETTINGS"
        kinds = drag.row(align=True)
        kinds.operator("cloak.stamp_drag", text="Drag Letter").kind = "LETTER"
        kinds.operator("cloak.stamp_drag", text="Drag Smiley").kind = "SMILEY"
        row = box.row(align=True)
        row.operator("cloak.logo_stamp", text="Stamp New Logo").add = False
        row.operator("cloak.logo_stamp", text="Add").add = True


class CLOAK_PT_heatmap(CloakPanel, label="Heatmap", inside="logo"):
    """A logo where the detector looks"""

    def draw(self, context: bpy.types.Context) -> None:
        column = settings_column(self.layout).column(align=True)
        column.operator("cloak.heatmap", icon="SHADING_RENDERED")
        if not body_reason(context) and layer_name(active_body(context).data, HEAT):
            shown = shows(active_body(context), HEATMAP)
            text = "Hide Heatmap" if shown else "Show Heatmap"
            column.operator("cloak.heatmap_toggle", text=text, icon="HIDE_ON" if shown else "HIDE_OFF")
            column.prop(context.scene.cloak, "heat_share")
            column.operator("cloak.logo_from_heat")
        self.outcome(context, "Heatmap")
