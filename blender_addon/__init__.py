# SPDX-License-Identifier: GPL-3.0-or-later
"""Cloak in Blender: pick faces of a character, train their colours in a process outside, see them on the model.

Registration only. The rooms: `mesh_arrays`, `body`, `faces`, `surface`, `stamp`, `poses`, `scene_export`, `runs`,
`colors`, `render_check` are plain functions over Blender's data; `trainer_python`, `trainer_install`, `command_lines`,
`jobs` and `progress` find, install, start and follow the process that trains; `run_states` and `run_list` find what was
trained before; `evaluations`, `ring`, `eye`, `onlooker`, `viewpoints`, `worn_scenes`, `outputs` judge a cloak and take
it along; `operators`, `tools`, `translations`, `preview`, `steps`, `panel`, `viewports`, `preferences`, `properties`
are what the user touches; `train.py` is the script that does the same without a window.
"""

from __future__ import annotations

import bpy

from . import jobs, operators, panel, preferences, properties, run_list, thumbnails, tools, translations, viewports

CLASSES = (*preferences.CLASSES, *operators.CLASSES, *panel.CLASSES)


def register() -> None:
    """Called by Blender when the extension is enabled."""
    properties.register()
    run_list.register()
    thumbnails.register()
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    viewports.register()
    tools.register()
    translations.register()
    preferences.look_ahead()


def unregister() -> None:
    """Called by Blender when the extension is disabled, and when Blender closes."""
    jobs.shut_down()
    translations.unregister()
    tools.unregister()
    viewports.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    thumbnails.unregister()
    run_list.unregister()
    properties.unregister()
