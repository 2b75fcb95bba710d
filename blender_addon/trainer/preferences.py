# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences: the program that trains; and the add-on's own folders."""

import functools
import time
from pathlib import Path
from types import SimpleNamespace

import bpy

from ..files.errors import InputError
from ..translations import said
from ..ui import props
from .program import find_program, install_line

PACKAGE = __package__.rpartition(".")[0]  # the add-on's name in Blender
LOOK_SECONDS = 5.0  # between two looks of the panel for the program


def preferences() -> "CloakPreferences | SimpleNamespace":
    """Return the add-on's preferences; empty ones that are not stored if it is not installed."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return addon.preferences if addon else SimpleNamespace(program="", wheel="", answer="")


def user_folder(name: str) -> Path:
    """A folder of the add-on's own for what can be made again, made if need be; removing the add-on removes it."""
    if PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(PACKAGE, path=name, create=True))
    return Path(bpy.utils.user_resource("DATAFILES", path=f"cloak/{name}", create=True))


def trainer() -> str:
    """The program to train with. Raises `InputError` with what to do."""
    return find_program(preferences().program, preferences().wheel)


def trainer_reason() -> str:
    """Why there is no trainer to start, "" when there is one; for redraws, which look every few seconds."""
    return _reason(preferences().program, preferences().wheel, time.monotonic() // LOOK_SECONDS)


@functools.lru_cache(1)
def _reason(program: str, wheel: str, moment: float) -> str:
    try:
        find_program(program, wheel)
    except InputError as error:
        return str(error)
    return ""


class CloakPreferences(bpy.types.AddonPreferences):
    """Which trainer to use."""

    bl_idname = PACKAGE

    program: props.path(
        "Trainer",
        "The program cloak, a Python that has cloak_core, or the folder of a checkout; empty to look in known places",
        relative=False,
    )
    wheel: props.path("Wheel", "The file cloak_core-....whl, for the line that installs the trainer", relative=False)
    answer: props.text("Answer", "What the trainer said when it was last tested", options={"SKIP_SAVE"})

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        row = layout.row(align=True)
        row.prop(self, "program")
        row.operator("cloak.test_trainer", text="Test")
        if self.answer or trainer_reason():
            layout.label(text=said(self.answer or trainer_reason()), icon="INFO")
        box = layout.box()
        box.label(text="The trainer is a program of its own. To install it, run this in a terminal:")
        box.prop(self, "wheel")
        row = box.row(align=True)
        row.label(text=install_line(self.wheel))
        row.operator("cloak.copy_install_line", text="", icon="COPYDOWN")
