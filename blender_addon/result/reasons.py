# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a cloak cannot be worn or judged now; "" means that it can. Cheap enough for every redraw."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..blender.blend_paths import absolute
from ..blender.colors import HEAT
from ..body.garments import is_dressed
from ..body.objects import active_body, require_upright
from ..body.reasons import body_reason, of_the_body, refusal
from ..poses.poses import PoseChoice
from ..poses.reasons import poses_reason
from ..properties import settings_of, train_request
from ..training.detectors import judges
from ..training.runs import run_of
from .outputs import made
from .viewpoints import middle_of, of_camera
from .worn_scenes import require_same_clothes


@of_the_body
def result_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there are no colours to show."""
    if not obj.cloak.run:
        return f"'{obj.name}' has no training yet: press Start, or choose a run in the list"
    run = run_of(obj)
    if not run.is_dir():
        return f"{run}: no such run folder"
    return "" if (run / "colors.npy").is_file() else f"{run.name}: no colours yet; wait for the first step"


def wear_reason(context: bpy.types.Context) -> str:
    """Why the body cannot be given, or be rid of, the colours."""
    reason = result_reason(context)
    return reason or ("Leave Edit Mode (Tab) to see the colours on the model" if context.mode != "OBJECT" else "")


@of_the_body
def report_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there is no report to open."""
    if not obj.cloak.run:
        return "Choose a run in the list first"
    run = run_of(obj)
    if (run / "report.html").is_file():
        return ""
    if not (run / "config.json").is_file():
        return f"{run}: not a run folder (no config.json in it), so there is nothing to report"
    return ""


@of_the_body
def check_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the cloak cannot be checked in Cycles."""
    if not is_dressed(obj):
        return f"'{obj.name}' shows its own materials: switch the cloak on first"
    return judged_reason(context) or refusal(judges, settings_of(context))


@of_the_body
def heatmap_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the detector cannot be asked which faces it looks at."""
    return refusal(require_upright, obj) or refusal(train_request, settings_of(context))


@of_the_body
def heat_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why no logo can be made of a heat map."""
    if obj.data.attributes.get(HEAT) is None:
        return f"'{obj.name}' has no heat map: press Heatmap first"
    return "Leave Edit Mode (Tab) to take faces from the heat map" if obj.mode == "EDIT" else ""


@of_the_body
def judged_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why nothing can be made of the body's run: no evaluation, no sheets to print, no film."""
    return result_reason(context) or worn_reason(obj) or refusal(require_same_clothes, obj, run_of(obj))


def worn_reason(obj: bpy.types.Object) -> str:
    """Why what is on the model is not what would be judged; "" when it is."""
    worn, run = obj.cloak.worn, run_of(obj)
    if not worn or run is None or Path(worn) == run or not is_dressed(obj):
        return ""
    return f"The model wears {Path(worn).name}, chosen is {run.name}: press Load Colours"


def evaluate_reason(context: bpy.types.Context) -> str:
    """Why the body's run cannot be evaluated."""
    reason = judged_reason(context)
    judging = settings_of(context).judging
    if reason or judging.bodies == "KEPT":
        return reason or _folder_reason(judging.backgrounds)
    choice = PoseChoice("RANGE", judging.frame_start, judging.frame_end, judging.frame_step)
    return poses_reason(context, choice) or _folder_reason(judging.backgrounds)


def _folder_reason(path: str) -> str:
    found = absolute(path)
    return "" if not found or Path(found).is_dir() else f"Backgrounds folder {found} does not exist"


def film_reason(context: bpy.types.Context) -> str:
    """Why no turntable can be made, and no sheets to print."""
    return judged_reason(context) or poses_reason(context, PoseChoice())


def camera_film_reason(context: bpy.types.Context) -> str:
    """Why no film can be made with the scene's camera."""
    reason = film_reason(context)
    if reason:
        return reason
    middle, metre = middle_of(active_body(context)), 1 / context.scene.unit_settings.scale_length
    return refusal(of_camera, context.scene, middle, metre)


@of_the_body
def made_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there is nothing to open that was made of the body's run."""
    reason = result_reason(context)
    return reason or ("" if made(run_of(obj)) else "Nothing was made of this run yet")


@of_the_body
def eye_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the detector cannot look at the body."""
    return poses_reason(context, PoseChoice()) or refusal(judges, settings_of(context))


def shown_heat_reason(context: bpy.types.Context) -> str:
    """Why a heat map can be neither shown nor hidden."""
    reason = body_reason(context)
    if reason or active_body(context).data.attributes.get(HEAT) is None:
        return reason or f"'{active_body(context).name}' has no heat map: press Heatmap first"
    return "Leave Edit Mode (Tab) to see the heat map" if context.mode != "OBJECT" else ""
