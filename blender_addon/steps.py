# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel's five steps: why each cannot run yet. "" means that it can. Cheap enough to ask on every redraw."""

from __future__ import annotations

from pathlib import Path

import bpy

from . import training_job
from .body import active_body, require_upright
from .faces import logo_names
from .files.errors import InputError
from .poses import list_poses
from .properties import absolute, pose_choice, settings_of, train_request
from .scene_export import clothing_of, topology_modifiers_reason


def body_reason(context: bpy.types.Context) -> str:
    """Why there is no usable body."""
    try:
        active_body(context)
    except InputError as error:
        return str(error)
    return ""


def logo_reason(context: bpy.types.Context) -> str:
    """Why there is no logo to train."""
    if body_reason(context):
        return "Choose a body first"
    obj = active_body(context)
    if logo_names(obj.data):
        return ""
    others = [o.name for o in context.view_layer.objects if o.type == "MESH" and o != obj and logo_names(o.data)]
    if others:
        return f"No logo on '{obj.name}'; '{others[0]}' has one: click that, or make one here"
    return "Make a logo first"


def poses_reason(context: bpy.types.Context) -> str:
    """Why the poses cannot be exported."""
    if body_reason(context):
        return "Choose a body first"
    obj = active_body(context)
    try:
        require_upright(obj)
        list_poses(obj, pose_choice(settings_of(context)))
    except InputError as error:
        return str(error)
    return topology_modifiers_reason(obj)


def train_reason(context: bpy.types.Context) -> str:
    """Why no training can start."""
    for reason in (logo_reason(context), poses_reason(context)):
        if reason:
            return reason
    try:
        train_request(settings_of(context))
    except InputError as error:
        return str(error)
    return training_job.busy()


def resume_reason(context: bpy.types.Context) -> str:
    """Why the object's training cannot be resumed."""
    if body_reason(context):
        return "Choose a body first"
    run = active_body(context).cloak.run
    if not run:
        return "Nothing to resume"
    return training_job.busy()


def result_reason(context: bpy.types.Context) -> str:
    """Why there are no colours to show."""
    if body_reason(context):
        return "Choose a body first"
    run = active_body(context).cloak.run
    if not run:
        return "Train first, or choose a run folder"
    if not Path(absolute(run), "colors.npy").is_file():
        return "No colours yet"
    return ""


def export_summary(context: bpy.types.Context) -> str:
    """What will be exported, counted."""
    obj, settings = active_body(context), settings_of(context)
    poses = len(list_poses(obj, pose_choice(settings)))
    text = f"{poses} pose{'s' * (poses != 1)} of {len(obj.data.polygons):,} faces"
    if settings.clothing:
        worn = clothing_of(obj)
        text += f", clothing: {', '.join(o.name for o in worn) if worn else 'none found'}"
    return text
