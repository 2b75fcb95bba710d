# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences: the Python that has `cloak_core`, and the machine that it runs on."""

import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import bpy

from ..session import session
from ..translations import said
from ..ui import props
from .python import INSTALL_LINE, find_python, forget_answers, known_reason

PACKAGE = __package__.rpartition(".")[0]  # the add-on's name in Blender
CLICK_SECONDS = 0.2
INSTALLATION = "Installation"  # the label of the job that installs the trainer
LOG_LINES = 5


def preferences() -> "CloakPreferences | SimpleNamespace":
    """Return the add-on's preferences; empty ones that are not stored if it is not installed."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return addon.preferences if addon else SimpleNamespace(python="", source="", remote="", answer="")


def user_folder(name: str) -> Path:
    """A folder of the add-on's own, made if need be; the only place it writes to unasked."""
    if PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(PACKAGE, path=name, create=True))
    return Path(bpy.utils.user_resource("DATAFILES", path=f"cloak/{name}", create=True))


def look_ahead(kept: object = None, context: object = None) -> None:
    """Start to look for the trainer's Python in the background."""
    if not bpy.app.background:
        known_reason(preferences().python)


def local_python(chosen: str | None = None) -> str:
    """The Python of this machine to train with: the chosen one, that of the preferences unless given, or one found.

    Without a window nobody is kept waiting, so that it may take its time. Raises `InputError` with what to do.
    """
    patience = threading.TIMEOUT_MAX if bpy.app.background else CLICK_SECONDS
    return find_python(preferences().python if chosen is None else chosen, patience)


def chosen_python() -> str:
    """The Python to train with, on whichever machine; remembered once found. Raises `InputError` with what to do."""
    kept = preferences()
    if kept.remote.strip():
        return kept.remote_python
    python = local_python()
    kept.python = kept.python or python
    return python


def trainer_reason() -> str | None:
    """Why there is no trainer to start, "" when there is one, None while that is being found out. Never waits."""
    return "" if preferences().remote.strip() else known_reason(preferences().python)


def through(command: list[str]) -> list[str]:
    """A command of the trainer, on the machine that the preferences name."""
    kept = preferences()
    if not kept.remote.strip() or command[0] != kept.remote_python:
        return command
    script = str(Path(__file__).with_name("remote.py"))
    shared = bpy.path.abspath(kept.remote_shared)
    return [sys.executable, script, kept.remote, kept.remote_folder, shared, *command]


def use_python(python: str) -> None:
    """Train with this Python from now on, also after Blender was closed."""
    forget_answers()
    preferences().python = python
    bpy.context.preferences.is_dirty = True


class CloakPreferences(bpy.types.AddonPreferences):
    """Which trainer to use."""

    bl_idname = PACKAGE

    python: props.path(
        "Trainer's Python",
        "Python executable that has cloak_core installed; empty to look for one",
        relative=False,
        update=look_ahead,
    )
    source: props.path(
        "Source",
        "What is installed: the trainer's wheel (.whl), or the folder of Cloak's sources; empty for the wheel that "
        "came with the add-on",
        relative=False,
    )
    remote: props.text(
        "Other Machine", "What runs a line of shell on another machine, such as: ssh gpu-box. Empty: train on this one"
    )
    remote_folder: props.text("Folder There", "Folder on the other machine for scenes and runs", "/tmp/cloak")
    remote_shared: props.path(
        "The Same Folder Here",
        "Where this machine sees the other's folder, when they share it; empty: files go by the command",
        "DIR_PATH",
        relative=False,
    )
    remote_python: props.text("Python There", "Python on the other machine that has cloak_core", "python3")
    answer: props.text("Answer", "What the trainer said when it was last tested", options={"SKIP_SAVE"})

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        row = layout.row(align=True)
        row.prop(self, "python")
        row.operator("cloak.find_python", text="", icon="VIEWZOOM")
        row.operator("cloak.test_python", text="Test")
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
        row.operator("cloak.copy_install_line", text="", icon="COPYDOWN")

    def _draw_install(self, layout: bpy.types.UILayout) -> None:
        layout.prop(self, "source")
        row = layout.row(align=True)
        row.operator("cloak.install_trainer", text="Install Trainer...", icon="IMPORT")
        row.operator("cloak.show_install_log", text="", icon="TEXT")
        job = session.job
        if job is not None and job.label == INSTALLATION:
            row = layout.row(align=True)
            row.progress(factor=job.fraction, text=said(job.describe()))
            if job.running:
                row.operator("cloak.train_cancel", text="", icon="X")
            column = layout.column(align=True)
            for line in job.tail(LOG_LINES):
                column.label(text=line[:120])
