# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel's five steps: why each cannot run yet. "" means that it can. Cheap enough to ask on every redraw."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import bpy

from . import jobs, run_list
from .blend_paths import absolute
from .body import active_body, require_upright
from .colors import HEAT
from .command_lines import differing_options
from .faces import logo_names
from .files.errors import InputError
from .garments import also_wearing, clothing_of, is_dressed
from .modifiers import modifiers_reason
from .outputs import made
from .poses import PoseChoice, list_poses, require_size
from .properties import pose_choice, settings_of, train_request
from .run_states import DONE, RUNNING, RunState, read_state
from .simulations import require_own_animation
from .viewpoints import middle_of, of_camera

NO_BODY = "Choose a body first"


def refusal(check: Callable, *arguments: object) -> str:
    """What `check` has against its arguments; "" when nothing."""
    try:
        check(*arguments)
    except InputError as error:
        return str(error)
    return ""


def body_reason(context: bpy.types.Context) -> str:
    """Why there is no usable body."""
    return refusal(active_body, context)


def of_the_body(
    reason: Callable[[bpy.types.Context, bpy.types.Object], str],
) -> Callable[[bpy.types.Context], str]:
    """A reason that asks about the active body; where there is none, why not."""

    @functools.wraps(reason)
    def asked(context: bpy.types.Context) -> str:
        return body_reason(context) or reason(context, active_body(context))

    return asked


def idle_reason(context: bpy.types.Context) -> str:
    """Why no job can start that needs neither body nor settings."""
    return jobs.busy()


@of_the_body
def logo_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there is no logo to train."""
    if logo_names(obj.data):
        return ""
    others = [o.name for o in context.view_layer.objects if o.type == "MESH" and o != obj and logo_names(o.data)]
    if others:
        return f"No logo on '{obj.name}'; '{others[0]}' has one: click that, or make one here"
    return "Make a logo first"


@of_the_body
def upright_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why nothing can be stamped onto the body."""
    return refusal(require_upright, obj)


def poses_reason(context: bpy.types.Context, choice: PoseChoice | None = None) -> str:
    """Why the poses cannot be exported: those of step 3, or others."""
    reason = body_reason(context)
    if reason:
        return reason
    obj, choice = active_body(context), choice or pose_choice(settings_of(context))
    worn = clothing_of(obj) if settings_of(context).clothing else []
    reason = refusal(require_upright, obj) or refusal(require_size, obj) or refusal(list_poses, obj, choice)
    return reason or refusal(require_own_animation, [obj, *worn], choice) or modifiers_reason(obj)


def train_reason(context: bpy.types.Context) -> str:
    """Why no training can start."""
    reason = logo_reason(context) or poses_reason(context)
    return reason or refusal(train_request, settings_of(context)) or jobs.busy()


def selected_run(context: bpy.types.Context) -> RunState | None:
    """The run chosen in the list, as its folder tells it now."""
    chosen = run_list.selected_path(context)
    return read_state(Path(chosen)) if chosen else None


def _chosen_reason(state: RunState | None) -> str:
    if state is None:
        return "Choose a run in the list first"
    return "" if state.exists else f"{state.path} is gone: choose another run"


def stop_reason(context: bpy.types.Context) -> str:
    """Why the chosen run cannot be stopped."""
    state = selected_run(context)
    return _chosen_reason(state) or ("" if state.state == RUNNING else f"{state.title} is not being trained")


@of_the_body
def attach_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the chosen run cannot be followed."""
    return stop_reason(context) or jobs.busy()


def delete_reason(context: bpy.types.Context) -> str:
    """Why the chosen run cannot be deleted."""
    state = selected_run(context)
    busy = state is not None and state.state == RUNNING
    return _chosen_reason(state) or (f"{state.title} is being trained: stop it first" if busy else "")


def cancel_reason(context: bpy.types.Context) -> str:
    """Why nothing can be cancelled."""
    return "" if jobs.busy() else "Nothing is running"


def extend_reason(context: bpy.types.Context) -> str:
    """Why no training can go on from the chosen run's colours."""
    state = selected_run(context)
    reason = body_reason(context) or _chosen_reason(state) or train_reason(context)
    if reason:
        return reason
    if state.state == RUNNING:
        return f"{state.title} is being trained: stop it first"
    return "" if (state.path / "colors.npy").is_file() else f"{state.title} has no colours yet"


def kept_reason(context: bpy.types.Context) -> str:
    """What Resume keeps of the chosen run though the panel says something else by now; "" when all is the same."""
    state = selected_run(context)
    if state is None or not state.resumable or refusal(train_request, settings_of(context)):
        return ""
    kept = differing_options(list(state.options), train_request(settings_of(context)).options())
    return f"Resume keeps what {state.title} began with: {kept}; Extend takes the panel's settings" if kept else ""


@of_the_body
def resume_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the chosen run cannot go on."""
    state = selected_run(context)
    reason = jobs.busy() or _chosen_reason(state)
    if reason or state.resumable:
        return reason
    if state.state == RUNNING:
        return f"{state.title} is being trained: Attach follows it"
    if state.state == DONE:
        return f"{state.title} is done ({state.progress.describe()}): Extend trains on from its colours"
    if not state.path.is_dir():
        return f"{state.title} never began, so there is nothing to go on with: press Start"
    return f"{state.path}.input, which the add-on keeps for Resume, is not there: press Start, or Extend"


@of_the_body
def result_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there are no colours to show."""
    if not obj.cloak.run:
        return f"'{obj.name}' has no training yet: press Start, or choose a run in the list"
    run = Path(absolute(obj.cloak.run))
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
    run = Path(absolute(obj.cloak.run))
    if (run / "report.html").is_file():
        return ""
    if not (run / "config.json").is_file():
        return f"{run}: not a run folder (no config.json in it), so there is nothing to report"
    return jobs.busy()


@of_the_body
def check_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the cloak cannot be checked in Cycles."""
    if not is_dressed(obj):
        return f"'{obj.name}' shows its own materials: switch the cloak on first"
    return refusal(train_request, settings_of(context)) or jobs.busy()


@of_the_body
def heatmap_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the detector cannot be asked which faces it looks at."""
    return refusal(require_upright, obj) or refusal(train_request, settings_of(context)) or jobs.busy()


@of_the_body
def heat_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why no logo can be made of a heat map."""
    if obj.data.attributes.get(HEAT) is None:
        return f"'{obj.name}' has no heat map: press Heatmap first"
    return "Leave Edit Mode (Tab) to take faces from the heat map" if obj.mode == "EDIT" else ""


@of_the_body
def judged_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why nothing can be made of the body's run: no evaluation, no sheets to print, no film."""
    return result_reason(context) or jobs.busy()


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
    return reason or ("" if made(Path(absolute(obj.cloak.run))) else "Nothing was made of this run yet")


@of_the_body
def eye_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the detector cannot look at the body."""
    return poses_reason(context, PoseChoice()) or refusal(train_request, settings_of(context))


def shown_heat_reason(context: bpy.types.Context) -> str:
    """Why a heat map can be neither shown nor hidden."""
    reason = body_reason(context)
    if reason or active_body(context).data.attributes.get(HEAT) is None:
        return reason or f"'{active_body(context).name}' has no heat map: press Heatmap first"
    return "Leave Edit Mode (Tab) to see the heat map" if context.mode != "OBJECT" else ""


def export_summary(context: bpy.types.Context) -> str:
    """What will be exported, counted."""
    obj, settings = active_body(context), settings_of(context)
    poses = len(list_poses(obj, pose_choice(settings)))
    text = f"{poses} pose{'s' * (poses != 1)} of {len(obj.data.polygons):,} faces"
    worn = clothing_of(obj)
    too = [o.name for o in also_wearing(obj, obj.cloak.logo)]
    if settings.clothing:
        text += f", clothing: {', '.join(o.name for o in worn) if worn else 'none found'}"
        text += f"; the logo goes on over {', '.join(too)}" if too else ""
    elif too:
        text += f"; {', '.join(too)} has logo '{obj.cloak.logo}' too: Include Clothing trains it as one"
    return text
