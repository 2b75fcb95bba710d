# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of step 4: train the logo's colours against detectors."""

from __future__ import annotations

import bpy

from ..body.reasons import logo_reason
from ..properties import settings_of
from ..session import session
from ..translations import said
from ..ui.panel_parts import CLOSED, CloakPanel, settings_column, wrapped
from .detectors import CHECK, active_detector
from .reasons import kept_reason, train_reason

BLACK_BOX = "It only judges: its runtime gives no gradients to train with"


class CLOAK_UL_detectors(bpy.types.UIList):
    """The detectors to hide from, and those that only judge"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        split = layout.split(factor=0.7)
        mark = "HIDE_OFF" if item.only_judges else "TRACKER"
        split.label(text=item.title, icon=mark if item.works or not item.answer else "ERROR")
        split.label(text=f"{item.threshold:.2f}" if item.threshold else "")


class CLOAK_PT_train(CloakPanel, bpy.types.Panel):
    """Step 4: train the logo's colours against a detector"""

    bl_label = "4. Train"

    def draw(self, context: bpy.types.Context) -> None:
        settings = settings_of(context)
        reason = train_reason(context)
        self._detectors(context, settings)
        column = settings_column(self.layout)
        column.enabled = not logo_reason(context)
        column.prop(settings, "steps")
        if reason:
            self.say(context, reason)
        row = self.layout.row(align=True)
        row.operator("cloak.train_start", icon="PLAY")
        row.operator("cloak.train_resume")
        row.operator("cloak.train_extend")
        kept = kept_reason(context)
        if kept:
            wrapped(self.layout, context, kept)
        self.progress(context, "Training")

    def _detectors(self, context: bpy.types.Context, settings: bpy.types.PropertyGroup) -> None:
        """The list, which works without a body too; below it what is known of the chosen one."""
        row = self.layout.row()
        row.template_list("CLOAK_UL_detectors", "", settings, "detectors", settings, "detector_index", rows=2)
        side = row.column(align=True)
        side.operator("cloak.detector_add", text="", icon="ADD")
        side.operator("cloak.detector_remove", text="", icon="REMOVE")
        side.operator("cloak.detector_add_named", text="", icon="OUTLINER_OB_ARMATURE")
        chosen = active_detector(settings)
        if chosen is None:
            wrapped(self.layout, context, "Built-in detector; + adds others by their files")
            return
        column = settings_column(self.layout)
        for name in ("file", "weights") if chosen.file else ("spec",):
            if name != "weights" or chosen.file.lower().endswith(".cfg"):
                column.prop(chosen, name)
        column.prop(chosen, "options")
        column.prop(chosen, "threshold")
        if chosen.black_box:
            wrapped(self.layout, context, BLACK_BOX, icon="HIDE_OFF")
        else:
            column.prop(chosen, "judges")
        if chosen.checked and chosen.answer:
            words = f"{chosen.title} {said(chosen.answer)}"
            wrapped(self.layout, context, words, icon="CHECKMARK" if chosen.works else "ERROR")
        else:
            self.layout.operator("cloak.detector_check", icon="VIEWZOOM")
        if session.job_of(CHECK) and session.job_of(CHECK).active:
            self.progress(context, CHECK)


class CLOAK_PT_settings(CloakPanel, bpy.types.Panel):
    """What else a training can be told"""

    bl_label = "Settings"
    bl_parent_id = "CLOAK_PT_train"
    bl_options = CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        settings = settings_of(context)
        column = settings_column(self.layout)
        column.prop(settings, "backgrounds")
        column.prop(settings, "preset")
        column.prop(settings, "config")
        angles = column.column(align=True)
        angles.prop(settings, "angle_first", text="Angles (°)")
        angles.prop(settings, "angle_last", text="To (°)")
        angles.prop(settings, "angle_step", text="Step (°)")
        column.prop(settings, "device")
        column.prop(settings, "output")
        live = column.row(align=True, heading="Live Colours")
        live.prop(settings, "live", text="")
        live.prop(settings, "live_seconds", text="Seconds")
