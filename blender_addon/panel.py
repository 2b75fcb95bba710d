# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "Cloak" in the 3D viewport's sidebar: five steps, from a body to its trained colours."""

from __future__ import annotations

import textwrap

import bpy

from . import colors, faces, jobs, overlay, run_list, steps
from .body import active_body
from .modifiers import modifiers_reason
from .operators.heat import HEAT
from .properties import settings_of
from .run_states import DONE, FAILED, RUNNING, STOPPED, RunState


def wrapped(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "INFO") -> None:
    """A message over as many lines as the sidebar's width asks for."""
    scale = context.preferences.system.ui_scale
    width = max(20, int((context.region.width / scale - 60) / 6.2)) if context.region else 48
    column = layout.column(align=True)
    column.scale_y = 0.85
    for index, line in enumerate(textwrap.wrap(text, width) or [""]):
        column.label(text=line, icon=icon if index == 0 else "BLANK1")


def settings_column(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """A column of settings: names on the left, values on the right."""
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    return column


class CloakPanel:
    """Base of the five steps."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Cloak"

    def gate(self, context: bpy.types.Context, reason: str) -> bpy.types.UILayout:
        """A column to draw into, greyed out below its reason when there is one."""
        if reason:
            self.say(context, reason)
        column = settings_column(self.layout)
        column.enabled = not reason
        return column

    def say(self, context: bpy.types.Context, reason: str) -> None:
        """Why a step cannot run; what is wrong with the body stands in step 1."""
        wrapped(self.layout, context, steps.NO_BODY if steps.body_reason(context) else reason)

    def progress(self, context: bpy.types.Context, *labels: str) -> None:
        """The job that was started from this panel: its progress, or how it ended."""
        job = jobs.current
        if job is None or job.label not in labels:
            return
        if job.running:
            row = self.layout.row(align=True)
            row.progress(factor=job.fraction, text=job.describe())
            row.operator("cloak.train_cancel", text="", icon="X")
            if isinstance(job, jobs.TrainingJob) and job.progress.figures():
                self.layout.label(text=job.progress.figures().capitalize(), icon="BLANK1")
            if job.notice:
                wrapped(self.layout, context, job.notice, icon="ERROR")
        elif job.message:
            wrapped(self.layout, context, job.message, icon="ERROR" if job.state == "failed" else "CHECKMARK")


class CLOAK_PT_body(CloakPanel, bpy.types.Panel):
    """Step 1: the mesh that wears the logo"""

    bl_label = "1. Body"

    def draw(self, context: bpy.types.Context) -> None:
        reason = steps.body_reason(context)
        if reason:
            wrapped(self.layout, context, reason)
        column = settings_column(self.layout)
        column.enabled = not reason
        if not reason:
            obj = active_body(context)
            column.label(text=obj.name, icon="MESH_DATA")
            counts = f"{len(obj.data.vertices):,} vertices, {len(obj.data.polygons):,} faces"
            column.label(text=counts if obj.mode != "EDIT" else "Counts: leave Edit Mode", icon="BLANK1")
        row = column.row(align=True)
        row.operator("cloak.subdivide", text="Subdivide")
        row.prop(settings_of(context), "triangulate", toggle=True)
        sample = self.layout.column()
        sample.enabled = not jobs.busy()
        sample.operator("cloak.add_sample_body", icon="ADD")
        self.progress(context, "Sample body")


class CLOAK_UL_logos(bpy.types.UIList):
    """The mesh's logos: its boolean face attributes"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        layout.prop(item, "name", text="", emboss=False, icon="FACESEL")

    def filter_items(self, context, data, property) -> tuple[list[int], list[int]]:
        return [self.bitflag_filter_item if faces.is_logo(a) else 0 for a in getattr(data, property)], []


class CLOAK_PT_logo(CloakPanel, bpy.types.Panel):
    """Step 2: the faces that get trained colours"""

    bl_label = "2. Logo"

    def draw(self, context: bpy.types.Context) -> None:
        reason = steps.body_reason(context)
        column = self.gate(context, reason)
        settings = settings_of(context)
        if not reason:
            self._list(column, active_body(context))
            self._stats(column, active_body(context), settings)
        self._stamp(column, settings)
        heat = column.box().column(align=True)
        row = heat.row(align=True)
        row.enabled = not jobs.busy()
        row.operator("cloak.heatmap", icon="SHADING_RENDERED")
        if not reason and active_body(context).data.attributes.get(HEAT):
            heat.prop(settings, "heat_share")
            heat.operator("cloak.logo_from_heat")
        self.progress(context, "Heatmap")

    def _list(self, column: bpy.types.UILayout, obj: bpy.types.Object) -> None:
        row = column.row()
        row.template_list("CLOAK_UL_logos", "", obj.data, "attributes", obj.cloak, "logo_index", rows=3)
        side = row.column(align=True)
        side.operator("cloak.logo_new", text="", icon="ADD")
        side.operator("cloak.logo_remove", text="", icon="REMOVE")
        has_logo = bool(faces.logo_names(obj.data))
        for names in (("assign", "unassign", "select"), ("mirror", "grow", "shrink"), ("export", "import")):
            row = column.row(align=True)
            for name in names:
                cell = row.row(align=True)
                cell.enabled = has_logo or name == "import"
                label = {"export": "Export Face List", "import": "Import"}.get(name)
                cell.operator(f"cloak.logo_{name}", **({"text": label} if label else {}))

    def _stats(self, column: bpy.types.UILayout, obj: bpy.types.Object, settings: bpy.types.PropertyGroup) -> None:
        stats = overlay.active_stats(obj)
        if stats is not None:
            lines = column.column(align=True)
            lines.label(text=f"{stats.faces:,} faces, {stats.area_share:.1%} of the area", icon="FACESEL")
            lines.label(
                text=f"From the front: {stats.projected_area:.3f} m², {stats.projected_share:.1%}", icon="BLANK1"
            )
            if not stats.faces:
                lines.label(text="Empty: select faces and press Assign", icon="ERROR")
            if stats.hidden:
                lines.label(text=f"{stats.hidden:,} faces are hidden (Alt H shows them)", icon="HIDE_ON")
        column.prop(settings, "tint")

    def _stamp(self, column: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
        box = column.box().column(align=True)
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
        row = box.row(align=True)
        row.operator("cloak.logo_stamp", text="Stamp New Logo").target = "NEW"
        row.operator("cloak.logo_stamp", text="Add").target = "ADD"


class CLOAK_PT_poses(CloakPanel, bpy.types.Panel):
    """Step 3: the poses to train on"""

    bl_label = "3. Poses"

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


class CLOAK_PT_train(CloakPanel, bpy.types.Panel):
    """Step 4: train the logo's colours against a detector"""

    bl_label = "4. Train"

    def draw(self, context: bpy.types.Context) -> None:
        settings = settings_of(context)
        reason, running = steps.train_reason(context), bool(jobs.busy())
        column = settings_column(self.layout)
        column.enabled = not steps.logo_reason(context) and not running
        self._detector(column, settings)
        column.prop(settings, "backgrounds")
        column.prop(settings, "preset")
        column.prop(settings, "config")
        angles = column.column(align=True)
        angles.prop(settings, "angle_first", text="Angles From")
        angles.prop(settings, "angle_last", text="To")
        angles.prop(settings, "angle_step", text="Step")
        column.prop(settings, "steps")
        column.prop(settings, "device")
        column.prop(settings, "output")
        live = column.row(align=True, heading="Live Colours")
        live.prop(settings, "live", text="")
        live.prop(settings, "live_seconds", text="Seconds")
        if reason and not (isinstance(jobs.current, jobs.TrainingJob) and running):
            self.say(context, reason)
        row = self.layout.row(align=True)
        row.operator("cloak.train_start", icon="PLAY")
        row.operator("cloak.train_resume", icon="FILE_REFRESH")
        self.progress(context, "Training")

    def _detector(self, column: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
        column.prop(settings, "detector")
        for name in {
            "DARKNET": ("darknet_cfg", "darknet_weights"),
            "TORCHVISION": ("torchvision_name", "torchvision_checkpoint"),
            "PYTHON": ("python_file", "python_function"),
        }.get(settings.detector, ()):
            column.prop(settings, name)


RUN_ICONS = {RUNNING: "PLAY", DONE: "CHECKMARK", STOPPED: "PAUSE", FAILED: "ERROR"}


class CLOAK_UL_runs(bpy.types.UIList):
    """The runs that were found, the latest first"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        state = run_list.states.get(item.path)
        if state is None:
            return
        split = layout.split(factor=0.55)
        split.label(text=state.title, icon=RUN_ICONS[state.state])
        figures = split.row()
        figures.label(text=f"{state.progress.step}/{state.progress.steps or '?'}")
        success = state.progress.success
        figures.label(text="" if success is None else f"{success:.0%}")


class CLOAK_PT_runs(CloakPanel, bpy.types.Panel):
    """Every training there is: beside the file, in the output folder, worn by a body"""

    bl_label = "Runs"

    def draw(self, context: bpy.types.Context) -> None:
        run_list.is_drawn()
        window = context.window_manager.cloak
        row = self.layout.row()
        row.template_list("CLOAK_UL_runs", "", window, "runs", window, "run_index", rows=4)
        side = row.column(align=True)
        side.operator("cloak.run_attach", text="", icon="LINKED")
        side.operator("cloak.run_stop", text="", icon="PAUSE")
        side.separator()
        side.operator("cloak.run_delete", text="", icon="TRASH")
        state = run_list.selected(context)
        if state is not None:
            self._chosen(context, state)
        if not steps.body_reason(context):
            settings_column(self.layout).prop(active_body(context).cloak, "run")

    def _chosen(self, context: bpy.types.Context, state: RunState) -> None:
        of = f" of '{state.object}', logo '{state.logo}'" if state.object else ""
        against = f", against {', '.join(state.detectors)}" if state.detectors else ""
        words = f"{state.state.capitalize()} at {state.progress.describe()}{of}{against}"
        wrapped(self.layout, context, f"{words}: {state.why}" if state.why else words, icon=RUN_ICONS[state.state])


class CLOAK_PT_result(CloakPanel, bpy.types.Panel):
    """Step 5: the trained colours on the model"""

    bl_label = "5. Result"

    def draw(self, context: bpy.types.Context) -> None:
        reason = steps.result_reason(context)
        column = self.gate(context, reason)
        dressed = not reason and colors.is_dressed(active_body(context))
        column.operator("cloak.result_load", icon="IMPORT")
        column.operator("cloak.result_toggle", text="Show Original" if dressed else "Show Cloak", icon="HIDE_OFF")
        warning = colors.view_transform_reason(context.scene)
        if warning and not reason:
            box = self.layout.box()
            wrapped(box, context, warning, icon="ERROR")
            box.operator("cloak.use_standard_view")
        row = column.row(align=True)
        row.operator("cloak.open_report", icon="URL")
        check = row.row(align=True)
        check.enabled = dressed and not jobs.busy()
        check.operator("cloak.render_check", icon="RENDER_STILL")
        self.progress(context, "Render check", "Report")
        shown = jobs.current is not None and jobs.current.label == "Render check"
        if not reason and active_body(context).cloak.verdict and not shown:
            wrapped(self.layout, context, active_body(context).cloak.verdict, icon="RENDER_RESULT")


CLASSES = (
    CLOAK_UL_logos,
    CLOAK_UL_runs,
    CLOAK_PT_body,
    CLOAK_PT_logo,
    CLOAK_PT_poses,
    CLOAK_PT_train,
    CLOAK_PT_runs,
    CLOAK_PT_result,
)
