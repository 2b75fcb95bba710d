# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 4: start, cancel and resume a training, and what happens while it runs."""

from __future__ import annotations

import time
from pathlib import Path

import bpy

from .. import jobs, runs
from ..body import active_body
from ..command_lines import train_command
from ..exchange.face_lists import read_face_list
from ..files.errors import InputError
from ..jobs import Job, TrainingJob, launch, require_idle
from ..preferences import chosen_python
from ..properties import absolute, output_folder, pose_choice, settings_of, train_request
from ..scene_export import Export, export, read_export
from .base import CloakOperator, push_undo
from .logo import active_logo


class CLOAK_OT_train_start(CloakOperator):
    """Export the body's poses and the active logo, and train the logo's colours in a process of its own"""

    bl_label = "Start"

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        obj, settings = active_body(context), settings_of(context)
        logo = active_logo(obj)
        request, python = train_request(settings), chosen_python()
        if obj.mode == "EDIT":
            bpy.ops.object.mode_set(mode="OBJECT")
        run = runs.new_run(output_folder(settings), obj.name, logo)
        done = export(context, obj, logo, pose_choice(settings), runs.input_folder(run), settings.clothing)
        runs.remember_options(run, request.options())
        begin(obj, run, train_command(python, request.options(), done.scene, done.face_list, run))
        return f"Training '{logo}' on {done.poses} poses of '{obj.name}' in {run}"


class CLOAK_OT_train_cancel(CloakOperator):
    """End the running job; a training ends after the current step and can be resumed"""

    bl_label = "Cancel"

    def run(self, context: bpy.types.Context) -> str:
        job = jobs.current
        if job is None or not job.running:
            raise InputError("Nothing is running")
        job.cancel()
        return f"Stopping: {job.label}"


class CLOAK_OT_train_resume(CloakOperator):
    """Go on with this object's training from its last checkpoint"""

    bl_label = "Resume"

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        obj = active_body(context)
        run = resumable_run(obj)
        done = read_export(runs.input_folder(run))
        runs.require_same_topology(obj, done.topology)
        options = runs.remembered_options(run)
        command = train_command(chosen_python(), options, done.scene, done.face_list, run)
        begin(obj, run, [*command, "--resume"])
        return f"Resuming {run}"


def resumable_run(obj: bpy.types.Object) -> Path:
    """The object's run, if it has one whose input is still there."""
    if not obj.cloak.run:
        raise InputError(f"'{obj.name}' has no training to resume: press Start")
    run = Path(absolute(obj.cloak.run))
    if not runs.input_folder(run).is_dir():
        raise InputError(f"{runs.input_folder(run)} is gone, so the run cannot be resumed: press Start")
    return run


def begin(obj: bpy.types.Object, run: Path, command: list[str]) -> None:
    """Launch the training and wire its live colours."""
    folder = runs.input_folder(run)
    watch = Watch(obj, run, read_export(folder))
    job = TrainingJob(command, run, folder, watch.finish)
    obj.cloak.run, obj.cloak.verdict = str(run), ""
    jobs.on_tick[:] = [watch.tick]
    launch(job)


class Watch:
    """Looks after one training on the main thread: redraws the panel, shows live colours, imports the last ones."""

    def __init__(self, obj: bpy.types.Object, run: Path, done: Export) -> None:
        self._live = runs.LiveColors(obj, run, done.topology, read_face_list(done.face_list).ids)
        self._run = run
        self._refused = ""
        self._last = time.monotonic()

    def tick(self, job: Job) -> None:
        """Called by the timer."""
        redraw()
        settings = settings_of(bpy.context)
        if not job.running or not settings.live or self._refused:
            return
        if time.monotonic() - self._last < settings.live_seconds:
            return
        try:
            self._live.update(bpy.context)
        except InputError as error:
            self._refused = str(error)
        self._last = time.monotonic()

    def finish(self, job: Job) -> str | None:
        """Called at the end: whatever colours there are come onto the model."""
        if not (self._run / "colors.npy").exists():
            return None
        obj = self._live.object
        try:
            if obj is None:
                raise InputError("the object is gone; open its file and press Load Colours")
            if obj.mode == "EDIT":
                raise InputError("leave Edit Mode (Tab) and press Load Colours")
            runs.import_colors(bpy.context, obj, self._run)
            push_undo("Cloak Colours")
        except InputError as error:
            return f"{job.message}; no colours imported: {error}"
        return None


def redraw() -> None:
    """Redraw the sidebars: progress has changed."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PREFERENCES"):
                area.tag_redraw()


CLASSES = (CLOAK_OT_train_start, CLOAK_OT_train_cancel, CLOAK_OT_train_resume)
