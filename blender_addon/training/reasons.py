# SPDX-License-Identifier: GPL-3.0-or-later
"""Why nothing can be trained, resumed or followed now; "" means that it can. Cheap enough for every redraw."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..body.objects import body_reason, logo_reason, of_the_body, refusal
from ..poses.reasons import poses_reason
from ..properties import train_request
from ..session import session
from ..trainer import jobs
from ..trainer.command_lines import differing_options
from . import run_list
from .run_states import DONE, RUNNING, RunState, read_state


def train_reason(context: bpy.types.Context) -> str:
    """Why no training can start."""
    reason = logo_reason(context) or poses_reason(context)
    return reason or refusal(train_request, context.scene.cloak)


def selected_run(context: bpy.types.Context) -> RunState | None:
    """Read the state of the run that is chosen in the list."""
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


def attach_reason(context: bpy.types.Context) -> str:
    """Why the chosen run cannot be followed."""
    reason = stop_reason(context)
    if reason:
        return reason
    state = selected_run(context)
    return f"{state.title} is followed already" if session.training_of(state.path) else ""


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
    """Which of the chosen run's options Resume keeps although the panel differs; "" if none."""
    state = selected_run(context)
    if state is None or not state.resumable or refusal(train_request, context.scene.cloak):
        return ""
    kept = differing_options(list(state.options), train_request(context.scene.cloak).options())
    return f"Resume keeps what {state.title} began with: {kept}; Extend takes the panel's settings" if kept else ""


@of_the_body
def resume_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the chosen run cannot go on."""
    state = selected_run(context)
    reason = _chosen_reason(state)
    if reason or state.resumable:
        return reason
    if state.state == RUNNING:
        return f"{state.title} is being trained: Attach follows it"
    if state.state == DONE:
        return f"{state.title} is done ({state.progress.describe()}): Extend trains on from its colours"
    if not state.path.is_dir():
        return f"{state.title} never began, so there is nothing to go on with: press Start"
    return f"{state.path}.input, which the add-on keeps for Resume, is not there: press Start, or Extend"
