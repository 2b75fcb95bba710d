# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 4: start, cancel and resume a training, and what happens while it runs."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import numpy as np

from .. import jobs, run_list, runs, steps
from ..blend_paths import blend_folder, portable
from ..body import active_body
from ..command_lines import train_command
from ..exchange.face_lists import read_face_list
from ..files.errors import InputError
from ..jobs import Job, TrainingJob, launch, require_idle
from ..preferences import chosen_python
from ..properties import output_folder, pose_choice, settings_of, train_request
from ..run_list import redraw
from ..scene_export import export, read_export
from ..steps import refusal
from .base import CloakOperator, push_undo
from .logo import active_logo


class CLOAK_OT_train_start(CloakOperator):
    """Export the body's poses and the active logo, and train the logo's colours in a process of its own"""

    bl_label = "Start"
    needs = staticmethod(steps.train_reason)

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        obj, settings = active_body(context), settings_of(context)
        logo = active_logo(obj)
        request, python = train_request(settings), chosen_python()
        if obj.mode == "EDIT":
            bpy.ops.object.mode_set(mode="OBJECT")
        _remove_failed_start()
        run = runs.new_run(output_folder(settings), obj.name, logo)
        done = export(context, obj, logo, pose_choice(settings), runs.input_folder(run), settings.clothing)
        runs.remember_options(run, request.options())
        begin(obj, run, train_command(python, request.options(), done.scene, done.face_list, run))
        return f"Training '{logo}' on {done.poses} poses of '{obj.name}' in {run}"


def _remove_failed_start() -> None:
    """What the last Start left when its training never began: the panel has told why, the next one takes its place."""
    job = jobs.current
    if isinstance(job, TrainingJob) and not job.run.exists() and runs.input_folder(job.run).is_dir():
        runs.remove(job.run)


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
    needs = staticmethod(steps.resume_reason)

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        obj, run = active_body(context), steps.selected_run(context).path
        done = read_export(runs.input_folder(run))
        runs.require_same_topology(obj, done.topology)
        options = runs.remembered_options(run)
        command = train_command(chosen_python(), options, done.scene, done.face_list, run)
        begin(obj, run, [*command, "--resume"])
        return f"Resuming {run}"


def begin(obj: bpy.types.Object, run: Path, command: list[str]) -> None:
    """Launch the training and wire its live colours."""
    folder = runs.input_folder(run)
    done = read_export(folder)
    watch = Watch(obj, run, read_face_list(done.face_list).ids, done.topology)
    follow(obj, TrainingJob(command, run, folder, watch.finish), watch)


def follow(obj: bpy.types.Object, job: TrainingJob, watch: Watch) -> None:
    """Make a training the current job, and its run the body's."""
    obj.cloak.run, obj.cloak.verdict = portable(str(job.run), blend_folder()), ""
    jobs.on_tick[:] = [watch.tick]
    launch(job)
    run_list.refresh(bpy.context)


class Watch:
    """Looks after one training on the main thread: redraws the panel, shows live colours, imports the last ones."""

    def __init__(self, obj: bpy.types.Object, run: Path, face_ids: np.ndarray, topology: str) -> None:
        self._live = runs.LiveColors(obj, run, topology, face_ids)
        self._run, self._name = run, obj.name
        self._refused = ""
        self._last = time.monotonic()

    def tick(self, job: Job) -> None:
        """Called by the timer."""
        redraw()
        if not job.running:
            return
        obj = self._live.object
        if obj is None or not obj.users_scene:
            job.notice = f"'{self._name}' was deleted: its training goes on in {self._run.name}. Ctrl Z brings it back"
            return
        settings = settings_of(bpy.context)
        if settings.live and time.monotonic() - self._last >= settings.live_seconds:
            self._refused = refusal(self._live.update, bpy.context)
            self._last = time.monotonic()
        job.notice = self._refused

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


CLASSES = (CLOAK_OT_train_start, CLOAK_OT_train_cancel, CLOAK_OT_train_resume)
