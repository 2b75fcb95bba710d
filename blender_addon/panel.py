# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "Cloak" in the 3D viewport's sidebar: five steps, from a body to its trained colours."""

from __future__ import annotations

import bpy

from . import faces, jobs, judge_panels, overlay, run_panels, steps
from .body import active_body
from .colors import HEAT, shows_heat
from .modifiers import modifiers_reason
from .panel_parts import CLOSED, CloakPanel, figure, settings_column, wrapped
from .poses import lying_warning
from .preferences import trainer_answer, trainer_reason
from .properties import settings_of
from .tools import PAINT

TRAINER = "The program that trains, outside of Blender; the add-on's preferences install, choose and test it"


class CLOAK_PT_body(CloakPanel, bpy.types.Panel):
    """Step 1: the mesh that wears the logo"""

    bl_label = "1. Body"

    @staticmethod
    def is_done(context: bpy.types.Context) -> bool:
        return not steps.body_reason(context)

    def draw(self, context: bpy.types.Context) -> None:
        reason = steps.body_reason(context)
        if reason:
            wrapped(self.layout, context, reason)
        column = settings_column(self.layout)
        column.enabled = not reason
        if not reason:
            obj = active_body(context)
            count = f"{len(obj.data.polygons):,} faces" if obj.mode != "EDIT" else "In Edit Mode"
            column.label(text=f"{obj.name}: {count}", icon="MESH_DATA")
        row = self.layout.row(align=True)
        splits = row.row(align=True)
        splits.enabled = not reason
        splits.operator("cloak.subdivide", text="Subdivide")
        splits.prop(settings_of(context), "triangulate", toggle=True)
        row = self.layout.row(align=True)
        row.operator("cloak.add_sample_body", text="Sample Body", icon="ADD").people = "BARE"
        row.operator("cloak.add_sample_body", text="Clothed", icon="ADD").people = "CLOTHED"
        self.progress(context, "Sample body")
        self._trainer(context)

    def _trainer(self, context: bpy.types.Context) -> None:
        """Who will train, or what to do about it that nobody can."""
        reason = trainer_reason()
        if reason:
            wrapped(self.layout, context, reason, icon="ERROR")
            row = self.layout.row(align=True)
            row.operator("cloak.install_trainer", text="Install Trainer...", icon="IMPORT")
            row.operator("cloak.find_python", text="", icon="VIEWZOOM")
            row.operator("preferences.addon_show", text="", icon="PREFERENCES").module = __package__
        elif reason is None:
            self.layout.label(text="Looking for the trainer...", icon="TIME")
        else:
            figure(self.layout, trainer_answer() or "Trainer found", TRAINER, "CONSOLE")
        self.progress(context, "Installation", "Test")


class CLOAK_UL_logos(bpy.types.UIList):
    """The mesh's logos: its boolean face attributes"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        layout.prop(item, "name", text="", emboss=False, icon="FACESEL")

    def filter_items(self, context, data, property) -> tuple[list[int], list[int]]:
        return [self.bitflag_filter_item if faces.is_logo(a) else 0 for a in getattr(data, property)], []


AREA = "Faces of the logo, and their share of the body's whole surface, as it stands now"
PROJECTED = (
    "What a camera in front sees of the logo: its area on the picture plane, and its share of the body's outline. The "
    "detector sees no more; hidden parts do not count"
)


class CLOAK_PT_logo(CloakPanel, bpy.types.Panel):
    """Step 2: the faces that get trained colours"""

    bl_label = "2. Logo"

    @staticmethod
    def is_done(context: bpy.types.Context) -> bool:
        return not steps.logo_reason(context)

    def draw(self, context: bpy.types.Context) -> None:
        reason = steps.body_reason(context)
        column = self.gate(context, reason)
        settings = settings_of(context)
        if not reason:
            self._list(column, active_body(context))
            self._stats(column, active_body(context), settings)

    def _list(self, column: bpy.types.UILayout, obj: bpy.types.Object) -> None:
        row = column.row()
        row.template_list("CLOAK_UL_logos", "", obj.data, "attributes", obj.cloak, "logo_index", rows=2)
        side = row.column(align=True)
        side.operator("cloak.logo_new", text="", icon="ADD")
        side.operator("cloak.logo_remove", text="", icon="REMOVE")
        column.operator("wm.tool_set_by_id", text="Paint with a Brush", icon="BRUSH_DATA").name = PAINT
        _buttons(column, "assign", "unassign", "select")

    def _stats(self, column: bpy.types.UILayout, obj: bpy.types.Object, settings: bpy.types.PropertyGroup) -> None:
        stats = overlay.active_stats(obj)
        if stats is not None:
            lines = column.column(align=True)
            figure(lines, f"{stats.faces:,} faces, {stats.area_share:.1%} of the area", AREA, "FACESEL")
            front = f"From the front: {stats.projected_area:.3f} m², {stats.projected_share:.1%}"
            figure(lines, front, PROJECTED)
            if not stats.faces:
                lines.label(text="Empty: select faces and press Assign", icon="ERROR")
            if stats.hidden:
                lines.label(text=f"{stats.hidden:,} faces are hidden (Alt H shows them)", icon="HIDE_ON")
        column.prop(settings, "tint")


def _buttons(column: bpy.types.UILayout, *names: str) -> None:
    """Operators of the active logo in one row."""
    row = column.row(align=True)
    for name in names:
        label = {"export": "Export Face List", "import": "Import"}.get(name)
        row.operator(f"cloak.logo_{name}", **({"text": label} if label else {}))


class CLOAK_PT_regions(CloakPanel, bpy.types.Panel):
    """Logos of what belongs together already, and what changes a logo as a whole"""

    bl_label = "Take, Change, Export"
    bl_parent_id = "CLOAK_PT_logo"
    bl_options = CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        column = settings_column(self.layout)
        column.enabled = not steps.body_reason(context)
        row = column.row(align=True)
        row.operator_menu_enum("cloak.logo_from_material", "slot", text="Material")
        row.operator_menu_enum("cloak.logo_from_group", "group", text="Group")
        row = column.row(align=True)
        row.operator_menu_enum("cloak.logo_from_face_set", "face_set", text="Face Set")
        row.operator("cloak.logo_from_island", text="Island")
        _buttons(column, "mirror", "grow", "shrink")
        _buttons(column, "export", "import")


class CLOAK_PT_stamp(CloakPanel, bpy.types.Panel):
    """A logo from a text, a picture or a smiley"""

    bl_label = "Stamp"
    bl_parent_id = "CLOAK_PT_logo"
    bl_options = CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        settings = settings_of(context)
        column = settings_column(self.layout)
        column.enabled = not steps.body_reason(context)
        box = column.column(align=True)
        box.row(align=True).prop(settings, "stamp_kind", expand=True)
        if settings.stamp_kind == "TEXT":
            box.prop(settings, "stamp_text")
        elif settings.stamp_kind == "IMAGE":
            box.template_ID(settings, "stamp_image", open="image.open")
        box.row(align=True).prop(settings, "stamp_from", expand=True)
        box.prop(settings, "stamp_size")
        if settings.stamp_from == "FRONT":
            box.prop(settings, "stamp_center")
            box.prop(settings, "stamp_offset")
        drag = column.column(align=True)
        drag.operator("cloak.stamp_drag", text="Drag onto the Body", icon="VIEW_PAN").kind = "SETTINGS"
        kinds = drag.row(align=True)
        kinds.operator("cloak.stamp_drag", text="Drag Letter").kind = "LETTER"
        kinds.operator("cloak.stamp_drag", text="Drag Smiley").kind = "SMILEY"
        presets = column.row(align=True)
        presets.operator("cloak.stamp_paper", text="Paper's Letter").kind = "TEXT"
        presets.operator("cloak.stamp_paper", text="Paper's Smiley").kind = "SMILEY"
        row = box.row(align=True)
        row.operator("cloak.logo_stamp", text="Stamp New Logo").target = "NEW"
        row.operator("cloak.logo_stamp", text="Add").target = "ADD"


class CLOAK_PT_heatmap(CloakPanel, bpy.types.Panel):
    """A logo where the detector looks"""

    bl_label = "Heatmap"
    bl_parent_id = "CLOAK_PT_logo"
    bl_options = CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        column = settings_column(self.layout).column(align=True)
        column.operator("cloak.heatmap", icon="SHADING_RENDERED")
        if not steps.body_reason(context) and active_body(context).data.attributes.get(HEAT):
            shown = shows_heat(active_body(context))
            text = "Hide Heatmap" if shown else "Show Heatmap"
            column.operator("cloak.heatmap_toggle", text=text, icon="HIDE_ON" if shown else "HIDE_OFF")
            column.prop(settings_of(context), "heat_share")
            column.operator("cloak.logo_from_heat")
        self.progress(context, "Heatmap")


class CLOAK_PT_poses(CloakPanel, bpy.types.Panel):
    """Step 3: the poses to train on"""

    bl_label = "3. Poses"
    bl_options = CLOSED

    def draw_header(self, context: bpy.types.Context) -> None:
        """Closed at first, because what it begins with suits most bodies; so what is wrong shows outside."""
        super().draw_header(context)
        if not steps.body_reason(context) and not self.is_done(context):
            self.layout.label(icon="ERROR")

    @staticmethod
    def is_done(context: bpy.types.Context) -> bool:
        return not steps.poses_reason(context)

    def draw(self, context: bpy.types.Context) -> None:
        no_body = steps.body_reason(context)
        column = self.gate(context, no_body)
        settings = settings_of(context)
        column.prop(settings, "pose_source")
        if settings.pose_source == "RANGE":
            pair = column.column(align=True)
            pair.prop(settings, "frame_start")
            pair.prop(settings, "frame_end", text="End")
        if settings.pose_source != "CURRENT":
            column.prop(settings, "frame_step", text="Step")
        column.prop(settings, "clothing")
        if no_body:
            return
        reason = steps.poses_reason(context)
        if reason:
            wrapped(column, context, reason, icon="ERROR")
            if modifiers_reason(active_body(context)):
                column.operator("cloak.apply_copy")
        else:
            wrapped(column, context, steps.export_summary(context), icon="EXPORT")
            if lying_warning(active_body(context)):
                wrapped(column, context, lying_warning(active_body(context)), icon="ERROR")


class CLOAK_PT_train(CloakPanel, bpy.types.Panel):
    """Step 4: train the logo's colours against a detector"""

    bl_label = "4. Train"

    def draw(self, context: bpy.types.Context) -> None:
        settings = settings_of(context)
        reason, running = steps.train_reason(context), bool(jobs.busy())
        column = settings_column(self.layout)
        column.enabled = not steps.logo_reason(context) and not running
        self._detector(column, settings)
        column.prop(settings, "steps")
        if reason and not (isinstance(jobs.current, jobs.TrainingJob) and running):
            self.say(context, reason)
        row = self.layout.row(align=True)
        row.operator("cloak.train_start", icon="PLAY")
        row.operator("cloak.train_resume", icon="FILE_REFRESH")
        row.operator("cloak.train_extend", icon="FORWARD")
        kept = "" if running else steps.kept_reason(context)
        if kept:
            wrapped(self.layout, context, kept)
        self.progress(context, "Training")

    def _detector(self, column: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
        column.prop(settings, "detector")
        for name in {
            "DARKNET": ("darknet_cfg", "darknet_weights"),
            "TORCHVISION": ("torchvision_name", "torchvision_checkpoint"),
            "PYTHON": ("python_file", "python_function"),
        }.get(settings.detector, ()):
            column.prop(settings, name)


class CLOAK_PT_settings(CloakPanel, bpy.types.Panel):
    """What else a training can be told"""

    bl_label = "Settings"
    bl_parent_id = "CLOAK_PT_train"
    bl_options = CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        settings = settings_of(context)
        column = settings_column(self.layout)
        column.enabled = not jobs.busy()
        column.prop(settings, "backgrounds")
        column.prop(settings, "preset")
        column.prop(settings, "config")
        angles = column.column(align=True)
        angles.prop(settings, "angle_first", text="Angles From")
        angles.prop(settings, "angle_last", text="To")
        angles.prop(settings, "angle_step", text="Step")
        column.prop(settings, "device")
        column.prop(settings, "output")
        live = column.row(align=True, heading="Live Colours")
        live.prop(settings, "live", text="")
        live.prop(settings, "live_seconds", text="Seconds")


CLASSES = (
    CLOAK_UL_logos,
    CLOAK_PT_body,
    CLOAK_PT_logo,
    CLOAK_PT_regions,
    CLOAK_PT_stamp,
    CLOAK_PT_heatmap,
    CLOAK_PT_poses,
    CLOAK_PT_train,
    CLOAK_PT_settings,
    *run_panels.CLASSES,
    *judge_panels.CLASSES,
)
