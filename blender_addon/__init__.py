# SPDX-License-Identifier: GPL-3.0-or-later
"""Cloak in Blender: choose faces of a body, train their colours in a separate process, show them on the body.

Packages by the panel's steps: `body`, `logo`, `poses`, `training`, `result`; each has plain functions over Blender's
data, its operators, the reasons why they cannot run now, and its panels. Below them `blender` (meshes, colours and
paths as numpy sees them), `ui` (what panels and operators are made of) and `trainer` (finding, starting and
following the process that trains). `session` holds what is true of this process alone; `headless` does the same
without a window.
"""

from importlib import import_module

import bpy

from . import headless, properties, translations
from .logo import overlay, paint
from .result import eye, ring
from .result import operators as wearing
from .session import session
from .trainer import jobs, program
from .training import run_list
from .ui import drawing

WITH_CLASSES = (
    *("trainer.panel", "body.panel", "logo.operators", "logo.paint", "training.detectors", "training.operators"),
    *("result.operators", "result.outputs", "result.judging"),
    *("logo.panel", "poses.panel", "training.panel", "result.panel"),
)
"""Modules whose classes are registered, in the order of the panels."""
ROOMS = (properties, run_list)  # modules that register something before the classes
WATCHERS = (drawing.HOOKS, overlay.HOOKS, ring.HOOKS, eye.HOOKS, paint, wearing, translations)
"""Objects that register something after the classes."""
_commands: list[object] = []  # of the command line: `blender --command cloak`
CLASSES = (
    program.CloakPreferences,
    *(
        cls
        for module in (import_module(f".{name}", __package__) for name in WITH_CLASSES)
        for cls in (getattr(thing, "operator", thing) for thing in vars(module).values())
        if getattr(cls, "__name__", "").startswith("CLOAK_") and cls.__module__ == module.__name__
    ),
)


def register() -> None:
    """Called by Blender when the extension is enabled."""
    for room in ROOMS:
        room.register()
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for room in WATCHERS:
        room.register()
    session.keeps = not bpy.app.background
    _commands.append(bpy.utils.register_cli_command("cloak", headless.run))


def unregister() -> None:
    """Called by Blender when the extension is disabled, and when Blender closes."""
    jobs.shut_down()
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    for room in reversed(WATCHERS):
        room.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    for room in reversed(ROOMS):
        room.unregister()
    session.reset()
