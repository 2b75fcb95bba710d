# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that test the trainer, and say how to get one."""

import json

import bpy

from ..ui.operator import CloakOperator
from .command_lines import cloak_command
from .jobs import Job, last_words, launch
from .preferences import preferences, trainer, user_folder
from .program import INSTALL_LINE


class CLOAK_OT_test_trainer(CloakOperator, label="Test Trainer"):
    """Start the trainer and show its version and device"""

    def run(self, context: bpy.types.Context) -> str:
        command = cloak_command(trainer(), "setup")
        preferences().answer = "Starting the trainer..."
        job = Job("Test", [command], user_folder("test"), "test", _answered)
        job.lane = "Test"
        launch(job)
        return "Testing the trainer: the answer appears in the preferences"


def _answered(job: Job) -> str:
    try:
        record = json.loads(job.outputs[-1]) if job.state == "done" else {}
        answer = "Cloak {cloak}, torch {torch}, Python {python}, {device}".format(**record)
    except (ValueError, KeyError, TypeError, IndexError):
        answer = f"The trainer does not work: {last_words(job.log) or 'no answer'}"
        job.state = "failed"
    preferences().answer = answer
    return answer


class CLOAK_OT_copy_install_line(CloakOperator, label="Copy Installation Line"):
    """Copy the line that installs the trainer to the clipboard"""

    def run(self, context: bpy.types.Context) -> str:
        context.window_manager.clipboard = INSTALL_LINE
        return "Copied: paste it into a terminal"
