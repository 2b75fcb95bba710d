# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel on top, the program that trains and the jobs that run; operators that test it and say how to get one."""

import json

import bpy

from ..files.errors import InputError
from ..files.specs import reach
from ..session import session
from ..translations import said
from ..ui import props
from ..ui.bases import CloakOperator, CloakPanel, figure, operator, wrapped
from ..ui.window import tool_at_work
from .jobs import Job, TrainingJob, last_words, launch
from .program import PACKAGE, allow, cloak_command, install_line, preferences, trainer, trainer_reason, user_folder

TRAINER = "The program that trains, outside of Blender; the add-on's preferences choose and test it"
FIGURES = (
    "Loss: what training makes small, of the last step. Success: the share of the last training images in which the "
    "detector does not report the body, a running mean"
)


@operator("Test Trainer")
def test_trainer(context: bpy.types.Context) -> str:
    """Start the trainer and show its version and device"""
    command = cloak_command(trainer(), "setup")
    preferences().answer = "Starting the trainer..."

    def ended(job: Job) -> str:
        try:
            record = json.loads(job.outputs[-1]) if job.state == "done" else {}
            answer = "Cloak {cloak}, torch {torch}, Python {python}, {device}".format(**record)
        except (ValueError, KeyError, TypeError, IndexError):
            answer = f"The trainer does not work: {last_words(job.log) or 'no answer'}"
            job.state = "failed"
        preferences().answer = answer
        return answer

    job = Job("Test", [command], user_folder("test"), "test", ended)
    job.lane = "Test"
    launch(job)
    return "Testing the trainer: the answer appears in the preferences"


@operator("Copy Installation Line")
def copy_install_line(context: bpy.types.Context) -> str:
    """Copy the line that installs the trainer to the clipboard"""
    context.window_manager.clipboard = install_line(preferences().wheel)
    return "Copied: paste it into a terminal"


class CLOAK_OT_allow(CloakOperator, label="Use What This File Names"):
    """Let the named detectors be used, as they are now, until Blender is closed"""

    specs: props.text("", "", options={"HIDDEN", "SKIP_SAVE"})  # a line each
    then: props.text("", "", options={"HIDDEN", "SKIP_SAVE"})  # the class of the operator that asked

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self, width=600, cancel_default=True)

    def draw(self, context: bpy.types.Context) -> None:
        for spec in self.specs.split("\n"):
            runs = reach(spec) == "runs code"
            self.layout.label(
                text="This runs code with all your rights:" if runs else "This asks the network:", icon="ERROR"
            )
            self.layout.label(text=spec, translate=False)
        self.layout.label(text="Only where you trust whoever made this file or folder")

    def run(self, context: bpy.types.Context) -> str:
        allow(self.specs.split("\n"))
        try:
            getattr(bpy.ops.cloak, self.then.removeprefix("CLOAK_OT_"))("INVOKE_DEFAULT")
        except RuntimeError as error:  # what that operator reported
            raise InputError(str(error).strip()) from None
        return ""


class CLOAK_PT_jobs(CloakPanel, label="Jobs"):
    """What runs outside Blender, and how far it is"""

    bl_options = {"HIDE_HEADER"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        session.panel_seen = True
        active = [(number, job) for number, job in enumerate(session.jobs) if job.active]
        for number, job in active:
            row = self.layout.row(align=True)
            row.progress(factor=job.fraction, text=said(job.describe()))
            row.operator("cloak.train_cancel", text="", icon="X").number = number
            if isinstance(job, TrainingJob) and job.progress.figures():
                figure(self.layout, job.progress.figures().capitalize(), FIGURES)
            if job.notice:
                wrapped(self.layout, context, job.notice, icon="ERROR")
        if active and (tool := tool_at_work()):
            wrapped(self.layout, context, f"What jobs bring waits for: {tool}")
        if reason := trainer_reason():
            wrapped(self.layout, context, reason)
            row = self.layout.row(align=True)
            row.operator("cloak.copy_install_line", icon="COPYDOWN")
            row.operator("preferences.addon_show", text="", icon="PREFERENCES").module = PACKAGE
        elif not active:
            figure(self.layout, preferences().answer or "Trainer found", TRAINER, "CONSOLE")
