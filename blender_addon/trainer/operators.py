# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that test the trainer, and say how to get one."""

import json

import bpy

from ..files.errors import InputError
from ..files.specs import reach
from ..ui import props
from ..ui.operator import CloakOperator
from .jobs import Job, last_words, launch
from .program import allow, cloak_command, install_line, preferences, trainer, user_folder


class CLOAK_OT_test_trainer(CloakOperator, label="Test Trainer"):
    """Start the trainer and show its version and device"""

    def run(self, context: bpy.types.Context) -> str:
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


class CLOAK_OT_copy_install_line(CloakOperator, label="Copy Installation Line"):
    """Copy the line that installs the trainer to the clipboard"""

    def run(self, context: bpy.types.Context) -> str:
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
