# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of step 4: train the logo's colours against detectors."""

import time

import bpy

from ..body.objects import active_body, body_reason, logo_reason, refusal
from ..files.specs import without_folders
from ..session import session
from ..translations import said
from ..ui.bases import CloakPanel, figure, settings_column, wrapped
from . import run_list
from .detectors import active_detector, judges
from .operators import kept_reason, train_reason
from .run_list import DONE, FAILED, RUNNING, STOPPED, RunState

BLACK_BOX = "It only judges: its runtime gives no gradients to train with"
RUN_ICONS = {RUNNING: "PLAY", DONE: "CHECKMARK", STOPPED: "PAUSE", FAILED: "ERROR"}
UNSEEN = (
    "Success on bodies and backgrounds that training never saw, measured by Evaluate, of several detectors the worst; "
    "own clothing and random colours are the controls, on the same images"
)


class CLOAK_UL_detectors(bpy.types.UIList):
    """The detectors to hide from, and those that only judge"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        split = layout.split(factor=0.7)
        mark = "HIDE_OFF" if item.only_judges else "TRACKER"
        split.label(text=item.title, icon=mark if item.works or not item.answer else "ERROR")
        split.label(text=f"{item.threshold:.2f}" if item.threshold else "")


class CLOAK_PT_train(CloakPanel, label="4. Train", trains=True):
    """Step 4: train the logo's colours against a detector"""

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.cloak
        self._detectors(context, settings)
        settings_column(self.layout, settings, "steps").enabled = not logo_reason(context)
        self.say(context, train_reason(context))
        row = self.layout.row(align=True)
        row.operator("cloak.train_start", icon="PLAY")
        row.operator("cloak.train_resume")
        row.operator("cloak.train_extend")
        if kept := kept_reason(context):
            wrapped(self.layout, context, kept)
        self.outcome(context, "Training")

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
            if not refusal(judges, settings):  # which is said above Start
                wrapped(self.layout, context, "Built-in detector; + adds others by their files")
            return
        column = settings_column(self.layout, chosen, "file" if chosen.file else "spec")
        if chosen.file.lower().endswith(".cfg"):
            column.prop(chosen, "weights")
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


class CLOAK_PT_settings(CloakPanel, label="Settings", inside="train"):
    """What else a training can be told"""

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.cloak
        column = settings_column(self.layout, settings, "backgrounds", "preset", "config")
        column.row(align=True).operator_enum("cloak.set_angles", "angles")
        angles = column.column(align=True)
        angles.prop(settings, "angle_first", text="Angles (°)")
        angles.prop(settings, "angle_last", text="To (°)")
        angles.prop(settings, "angle_step", text="Step (°)")
        column.prop(settings, "device")
        column.prop(settings, "output")
        live = column.row(align=True, heading="Live Colours")
        live.prop(settings, "live", text="")
        live.prop(settings, "live_seconds", text="Seconds")


class CLOAK_UL_runs(bpy.types.UIList):
    """The runs that were found, the latest first: steps, success in training and, where it was measured, unseen"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        state = session.runs.get(item.path)
        if state is None:
            return
        split = layout.split(factor=0.5)
        split.label(text=state.title, icon=RUN_ICONS[state.state])
        shares = (state.progress.success, state.unseen.get("logo"))  # in one label: of three each would be clipped
        split.label(
            text="  ".join([f"{state.progress.step:,}", *(f"{share:.0%}" for share in shares if share is not None)])
        )


class CLOAK_PT_runs(CloakPanel, label="Runs"):
    """Every training there is: beside the file, in the output folder, worn by a body"""

    def draw(self, context: bpy.types.Context) -> None:
        session.runs_drawn = time.monotonic()  # so that the list is refreshed
        window = context.window_manager.cloak
        row = self.layout.row()
        row.template_list("CLOAK_UL_runs", "", window, "runs", window, "run_index", rows=4)
        side = row.column(align=True)
        side.operator("cloak.run_attach", text="", icon="LINKED")
        side.operator("cloak.run_stop", text="", icon="PAUSE")
        side.separator()
        side.operator("cloak.run_delete", text="", icon="TRASH")
        if state := run_list.selected(context):
            self._chosen(context, state)
        if not body_reason(context):
            settings_column(self.layout, active_body(context).cloak, "run")

    def _chosen(self, context: bpy.types.Context, state: RunState) -> None:
        of = f" of '{state.object}', logo '{state.logo}'" if state.object else ""
        against = f", against {', '.join(map(without_folders, state.detectors))}" if state.detectors else ""
        reached = f" at {state.progress.describe()}" if state.progress.steps else ""
        words = f"{state.state.capitalize()}{reached}{of}{against}"
        wrapped(self.layout, context, f"{words}: {state.why}" if state.why else words, icon=RUN_ICONS[state.state])
        if unseen := state.unseen:
            named = (("Unseen", "logo"), ("Own clothing", "clothing"), ("Random", "random"))
            lines = self.layout.column(align=True)  # a line each: in one the last is cut off
            for name, control in named:
                if control in unseen:
                    icon = "VIEWZOOM" if control == "logo" else "BLANK1"
                    figure(lines, f"{said(name)} {unseen[control]:.0%}", UNSEEN, icon)
