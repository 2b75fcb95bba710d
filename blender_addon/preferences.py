# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences: the Python that has `cloak_core`; found, tested, or installed with a line to copy."""

from __future__ import annotations

import threading
from pathlib import Path

import bpy
from bpy.props import StringProperty

from .files.errors import InputError
from .jobs import Job, busy, last_words, launch, require_idle
from .operators.base import CloakOperator
from .trainer_python import INSTALL_LINE, about_command, ask_ahead, find_python, forget_answers, parse_about

CLICK_SECONDS = 0.2


def preferences() -> CloakPreferences | None:
    """The add-on's preferences; None where it runs without being installed."""
    addon = bpy.context.preferences.addons.get(__package__)
    return addon.preferences if addon else None


def user_folder(name: str) -> Path:
    """A folder of the add-on's own, made if need be; the only place it writes to unasked."""
    if __package__.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(__package__, path=name, create=True))
    return Path(bpy.utils.user_resource("DATAFILES", path=f"cloak/{name}", create=True))


def look_ahead() -> None:
    """Begin to look for the trainer's Python, so that nobody waits when it is needed."""
    kept = preferences()
    if not bpy.app.background:
        ask_ahead(kept.python if kept else "")


def _patience() -> float:
    """Seconds that a click may wait for a Python to answer; without a window there is nobody to keep waiting."""
    return threading.TIMEOUT_MAX if bpy.app.background else CLICK_SECONDS


def chosen_python() -> str:
    """The Python to train with; remembered once found. Raises `InputError` with what to do."""
    kept = preferences()
    python = find_python(kept.python if kept else "", _patience())
    if kept and not kept.python:
        kept.python = python
    return python


def _python_chosen(kept: CloakPreferences, context: bpy.types.Context) -> None:
    look_ahead()


class CloakPreferences(bpy.types.AddonPreferences):
    """Which trainer to use."""

    bl_idname = __package__

    python: StringProperty(
        name="Trainer's Python",
        description="Python executable that has cloak_core installed; empty to look for one",
        subtype="FILE_PATH",
        update=_python_chosen,
    )
    answer: StringProperty(
        name="Answer", description="What the trainer said when it was last tested", options={"SKIP_SAVE"}
    )

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        row = layout.row(align=True)
        row.prop(self, "python")
        row.operator(CLOAK_OT_find_python.bl_idname, text="", icon="VIEWZOOM")
        row.operator(CLOAK_OT_test_python.bl_idname, text="Test")
        if self.answer:
            layout.label(text=self.answer, icon="INFO")
        box = layout.box()
        box.label(text="To install the trainer, run this in the folder of Cloak's sources:")
        row = box.row(align=True)
        row.label(text=INSTALL_LINE)
        row.operator(CLOAK_OT_copy_install_line.bl_idname, text="", icon="COPYDOWN")


class CLOAK_OT_find_python(CloakOperator):
    """Look for a Python that has cloak_core"""

    bl_label = "Find Python"

    def run(self, context: bpy.types.Context) -> str:
        kept = preferences()
        forget_answers()
        python = find_python("", _patience())
        if kept:
            kept.python = python
        return f"Trainer's Python: {python}"


class CLOAK_OT_test_python(CloakOperator):
    """Start the trainer and show its version and device"""

    bl_label = "Test Trainer"

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        return busy()

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        python = chosen_python()
        kept = preferences()
        if kept:
            kept.answer = "Starting the trainer..."
        job = Job("Test", [about_command(python)], user_folder("test"), "test", lambda job: _show_answer(job, python))
        launch(job)
        return "Testing the trainer: the answer appears in the preferences"


def _show_answer(job: Job, python: str) -> str:
    try:
        facts = parse_about(python, job.state == "done", "".join(job.outputs), last_words(job.log))
        answer = f"Cloak {facts['cloak']}, torch {facts['torch']}, Python {facts['python']}, {facts['device']}"
    except InputError as error:
        answer = str(error)
    kept = preferences()
    if kept:
        kept.answer = answer
    return answer


class CLOAK_OT_copy_install_line(CloakOperator):
    """Copy the line that installs the trainer to the clipboard"""

    bl_label = "Copy Installation Line"

    def run(self, context: bpy.types.Context) -> str:
        context.window_manager.clipboard = INSTALL_LINE
        return "Copied: paste it into a terminal in the folder of Cloak's sources"


CLASSES = (CloakPreferences, CLOAK_OT_find_python, CLOAK_OT_test_python, CLOAK_OT_copy_install_line)
