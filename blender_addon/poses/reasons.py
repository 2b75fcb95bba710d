# SPDX-License-Identifier: GPL-3.0-or-later
"""Why the poses cannot be exported; "" means that they can. Cheap enough for every redraw."""

from __future__ import annotations

import bpy

from ..blender.modifiers import modifiers_reason
from ..body.garments import also_wearing, worn_by
from ..body.objects import active_body, body_reason, refusal, require_upright
from ..properties import pose_choice
from .poses import PoseChoice, list_poses, require_faces, require_own_animation, require_size


def poses_reason(context: bpy.types.Context, choice: PoseChoice | None = None) -> str:
    """Why the given poses (by default those of step 3) cannot be exported."""
    reason = body_reason(context)
    if reason:
        return reason
    obj, choice = active_body(context), choice or pose_choice(context.scene.cloak)
    reason = refusal(require_upright, obj) or refusal(require_faces, obj) or refusal(require_size, obj)
    reason = reason or refusal(list_poses, obj, choice)
    return reason or refusal(require_own_animation, [obj, *worn_by(obj)], choice) or modifiers_reason(obj)


def export_summary(context: bpy.types.Context) -> str:
    """What will be exported, counted."""
    obj, settings = active_body(context), context.scene.cloak
    poses = len(list_poses(obj, pose_choice(settings)))
    text = f"{poses} pose{'s' * (poses != 1)} of {len(obj.data.polygons):,} faces"
    worn, too = worn_by(obj), also_wearing(obj, obj.cloak.logo)
    if worn:
        text += f", with {', '.join(o.name for o in worn)}"
    if too:
        text += f"; the logo goes on over {', '.join(o.name for o in too)}"
    return text
