# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 4: start, extend, cancel and resume a training, and what happens while it runs."""

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
from ..faces import logo_names
from ..files.errors import InputError
from ..jobs import Job, TrainingJob, launch, require_idle
from ..preferences import chosen_python
from ..properties import output_folder, pose_choice, settings_of, train_request
from ..run_states import RunState
from ..scene_export import export, read_export
from ..steps import refusal
from .base import CloakOperator, push_undo
from .logo import active_logo


class CLOAK_OT_train_start(CloakOperator):
    """Export the body's poses and the active logo, and train the logo's colours in a process of its own"""

    bl_label = "Start"
    needs = staticmethod(steps.train_reason)

    def run(self, context: bpy.types.Context) -> str:
        return start(context)


class CLOAK_OT_train_extend(CloakOperator):
    """Train on from the colours of the chosen run, with the settings above, in a new run: for more steps, another \
detector or other angles. The run itself stays as it is"""

    bl_label = "Extend"
    needs = staticmethod(steps.extend_reason)

    def run(self, context: bpy.types.Context) -> str:
        return start(context, steps.selected_run(context))


def start(context: bpy.types.Context, begun: RunState | None = None) -> str:
    """Export and train in a new run; from the colours of another run where one is given."""
    require_idle()
    obj, settings = active_body(context), settings_of(context)
    logo = begun.logo if begun and begun.logo in logo_names(obj.data) else active_logo(obj)
    options, python = train_request(settings).options(), chosen_python()
    options += [f"--init={begun.path}"] if begun else []
    if obj.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    _remove_failed_start()
    run = runs.new_run(output_folder(settings), obj.name, logo)
    done = export(context, obj, logo, pose_choice(settings), runs.input_folder(run), settings.clothing)
    made_from, _, faces = obj.cloak.made_from.partition("|")
    options += [f"--made-from={made_from}"] if made_from and faces == read_face_list(done.face_list).topology else []
    runs.remember_options(run, options)
    begin(obj, run, train_command(python, options, done.scene, done.face_list, run))
    begins = f", from the colours of {begun.title}" if begun else ""
    return f"Training '{logo}' on {done.poses} poses of '{obj.name}' in {run}{begins}"


def _remove_failed_start() -> None:
    """What the last Start left when its training never began: the panel has told why, the next one takes its place."""
    job = jobs.current
    if isinstance(job, TrainingJob) and not job.run.exists() and runs.input_folder(job.run).is_dir():
        runs.remove(job.run)


class CLOAK_OT_train_cancel(CloakOperator):
    """End the running job; a training ends after the current step and can be resumed"""

    bl_label = "Cancel"
    needs = staticmethod(steps.cancel_reason)

    def run(self, context: bpy.types.Context) -> str:
        job = jobs.current
        job.cancel()
        return f"Stopping: {job.label}"


class CLOAK_OT_train_resume(CloakOperator):
    """Go on with the chosen run from its last checkpoint to its last step, with what it was started with"""

    bl_label = "Resume"
    needs = staticmethod(steps.resume_reason)

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        obj, state = active_body(context), steps.selected_run(context)
        done = read_export(runs.input_folder(state.path))
        runs.require_same_topology(obj, done.topology)
        kept = steps.kept_reason(context)
        command = train_command(chosen_python(), list(state.options), done.scene, done.face_list, state.path)
        begin(obj, state.path, [*command, "--resume"])
        return kept or f"Resuming {state.path}"


def begin(obj: bpy.types.Object, run: Path, command: list[str]) -> None:
    """Launch the training and wire its live colours."""
    folder = runs.input_folder(run)
    done = read_export(folder)
    watch = Watch(obj, run, read_face_list(done.face_list).ids, done.topology)
    follow(obj, TrainingJob(command, run, folder, watch.finish), watch)


def follow(obj: bpy.types.Object, job: TrainingJob, watch: Watch) -> None:
    """Make a training the current job, and its run the body's."""
    obj.cloak.run, obj.cloak.verdict = portable(str(job.run), blend_folder()), ""
    launch(job)
    jobs.on_tick[:] = [watch.tick]
    run_list.refresh(bpy.context)


class Watch:
    """Looks after one training on the main thread: shows live colours, imports the last ones."""

    def __init__(self, obj: bpy.types.Object, run: Path, face_ids: np.ndarray, topology: str) -> None:
        self._live = runs.LiveColors(obj, run, topology, face_ids)
        self._run, self._name = run, obj.name
        self._refused = ""
        self._last = time.monotonic()

    def tick(self, job: Job) -> None:
        """Called by the timer."""
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
        """Called at the end: the list of runs knows it, and whatever colours there are come onto the model."""
        run_list.refresh(bpy.context)
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


CLASSES = (CLOAK_OT_train_start, CLOAK_OT_train_extend, CLOAK_OT_train_cancel, CLOAK_OT_train_resume)
