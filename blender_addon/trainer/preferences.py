# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences: the Python that has `cloak_core`; found, tested, or installed."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..files.errors import InputError
from ..session import session
from ..translations import said
from ..ui.operator import CloakOperator
from .install import InstallJob
from .jobs import Job, busy, last_words, require_idle, run_command
from .python import INSTALL_LINE, about_command, ask_ahead, find_python, forget_answers, known_reason, parse_about

PACKAGE = __package__.rpartition(".")[0]
"""The add-on's name in Blender."""
CLICK_SECONDS = 0.2
LOG_LINES = 5


def preferences() -> CloakPreferences | None:
    """The add-on's preferences; None where it runs without being installed."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return addon.preferences if addon else None


def user_folder(name: str) -> Path:
    """A folder of the add-on's own, made if need be; the only place it writes to unasked."""
    if PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(PACKAGE, path=name, create=True))
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
    if kept and kept.remote.strip():
        return kept.remote_python
    python = find_python(kept.python if kept else "", _patience())
    if kept and not kept.python:
        kept.python = python
    return python


def trainer_reason() -> str | None:
    """Why there is no trainer to start, "" when there is one, None while that is being found out. Never waits."""
    kept = preferences()
    if kept and kept.remote.strip():
        return ""
    return known_reason(kept.python if kept else "")


def trainer_answer() -> str:
    """What the trainer said when it was last tested."""
    kept = preferences()
    return kept.answer if kept else ""


def local_python() -> str:
    """The Python of this machine, for what has to answer at once."""
    kept = preferences()
    return find_python(kept.python if kept else "", _patience())


def through(command: list[str]) -> list[str]:
    """A command of the trainer, on the machine that the preferences name."""
    kept = preferences()
    if not kept or not kept.remote.strip() or command[0] != kept.remote_python:
        return command
    script = str(Path(__file__).with_name("remote.py"))
    shared = bpy.path.abspath(kept.remote_shared)
    return [sys.executable, script, kept.remote, kept.remote_folder, shared, *command]


def use_python(python: str) -> None:
    """Train with this Python from now on, also after Blender was closed."""
    forget_answers()
    kept = preferences()
    if kept:
        kept.python = python
        bpy.context.preferences.is_dirty = True


def _python_chosen(kept: CloakPreferences, context: bpy.types.Context) -> None:
    look_ahead()


class CloakPreferences(bpy.types.AddonPreferences):
    """Which trainer to use."""

    bl_idname = PACKAGE

    python: StringProperty(
        name="Trainer's Python",
        description="Python executable that has cloak_core installed; empty to look for one",
        subtype="FILE_PATH",
        update=_python_chosen,
    )
    source: StringProperty(
        name="Source",
        description="What is installed: the trainer's wheel (.whl), or the folder of Cloak's sources; empty for the "
        "wheel that came with the add-on",
        subtype="FILE_PATH",
    )
    remote: StringProperty(
        name="Other Machine",
        description="What runs a line of shell on another machine, such as: ssh gpu-box. Empty: train on this one",
    )
    remote_folder: StringProperty(
        name="Folder There", description="Folder on the other machine for scenes and runs", default="/tmp/cloak"
    )
    remote_shared: StringProperty(
        name="The Same Folder Here",
        description="Where this machine sees the other's folder, when they share it; empty: files go by the command",
        subtype="DIR_PATH",
    )
    remote_python: StringProperty(
        name="Python There", description="Python on the other machine that has cloak_core", default="python3"
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
            layout.label(text=said(self.answer), icon="INFO")
        self._draw_install(layout.box())
        box = layout.box()
        box.prop(self, "remote")
        if self.remote.strip():
            for name in ("remote_folder", "remote_shared", "remote_python"):
                box.prop(self, name)
        box = layout.box()
        box.label(text="Or run this in the folder of Cloak's sources:")
        row = box.row(align=True)
        row.label(text=INSTALL_LINE)
        row.operator(CLOAK_OT_copy_install_line.bl_idname, text="", icon="COPYDOWN")

    def _draw_install(self, layout: bpy.types.UILayout) -> None:
        layout.prop(self, "source")
        row = layout.row(align=True)
        row.operator("cloak.install_trainer", text="Install Trainer...", icon="IMPORT")
        row.operator("cloak.show_install_log", text="", icon="TEXT")
        job = session.job
        if not isinstance(job, InstallJob):
            return
        row = layout.row(align=True)
        row.progress(factor=job.fraction, text=said(job.describe()))
        if job.running:
            row.operator("cloak.train_cancel", text="", icon="X")
        column = layout.column(align=True)
        for line in job.tail(LOG_LINES):
            column.label(text=line[:120])


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
        command = about_command(python)
        run_command("Test", command, user_folder("test"), "test", lambda job: _show_answer(job, python))
        return "Testing the trainer: the answer appears in the preferences"


def describe_trainer(python: str, done: bool, stdout: str, last_line: str) -> str:
    """One line about a trainer, from what `about_command` said; `InputError` where it does not work."""
    facts = parse_about(python, done, stdout, last_line)
    return f"Cloak {facts['cloak']}, torch {facts['torch']}, Python {facts['python']}, {facts['device']}"


def _show_answer(job: Job, python: str) -> str:
    try:
        answer = describe_trainer(python, job.state == "done", "".join(job.outputs), last_words(job.log))
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
