# SPDX-License-Identifier: GPL-3.0-or-later
"""Cloak in Blender: pick faces of a character, train their colours in a process outside, see them on the model.

Packages by the panel's steps: `body`, `logo`, `poses`, `training`, `result`; each has plain functions over Blender's
data, its operators, the reasons why they cannot run now, and its panels. Below them `blender` (meshes, colours and
paths as numpy sees them), `ui` (what panels and operators are made of) and `trainer` (finding, installing, starting and
following the process that trains). `session` holds what is true of this process alone; `train.py` does the same
without a window.
"""

from __future__ import annotations

import bpy

from . import properties, translations
from .body import operators as body_operators
from .body import panel as body_panel
from .logo import drag_stamp, heat, overlay, paint, pick, stamp_operators, tools
from .logo import operators as logo_operators
from .logo import panel as logo_panel
from .poses import panel as poses_panel
from .result import evaluate, eye, eye_drawing, judge_panels, output_operators, ring, wear
from .result import operators as result_operators
from .result import panel as result_panel
from .session import session
from .trainer import install_operators, jobs, preferences
from .training import detectors, run_list, run_operators, run_panels
from .training import operators as training_operators
from .training import panel as training_panel
from .ui import thumbnails

WITH_CLASSES = (
    *(preferences, install_operators, body_operators, logo_operators, pick, paint, stamp_operators, drag_stamp, heat),
    *(detectors, training_operators, run_operators, result_operators, evaluate, output_operators),
    *(body_panel, logo_panel, poses_panel, training_panel, run_panels, result_panel, judge_panels, wear),
)
"""Modules whose classes Blender is told of, in the order in which panels stand."""
KINDS = (bpy.types.Operator, bpy.types.Panel, bpy.types.UIList, bpy.types.AddonPreferences)
ROOMS = (properties, run_list, thumbnails)
"""What has something to register before the classes."""
WATCHERS = (overlay, ring, eye, eye_drawing, tools, translations)
"""The same after them."""


def _classes() -> tuple[type, ...]:
    """Of the modules above, what is named for Blender, in the order of its definition."""
    named = ((module, *pair) for module in WITH_CLASSES for pair in vars(module).items())
    return tuple(
        cls
        for module, name, cls in named
        if (
            isinstance(cls, type)
            and issubclass(cls, KINDS)
            and cls.__module__ == module.__name__
            and name.startswith("CLOAK_")
        )
        or cls is preferences.CloakPreferences
    )


CLASSES = _classes()


def register() -> None:
    """Called by Blender when the extension is enabled."""
    for room in ROOMS:
        room.register()
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for room in WATCHERS:
        room.register()
    preferences.look_ahead()


def unregister() -> None:
    """Called by Blender when the extension is disabled, and when Blender closes."""
    jobs.shut_down()
    for room in reversed(WATCHERS):
        room.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    for room in reversed(ROOMS):
        room.unregister()
    session.reset()
