# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 4: start, extend, cancel and resume a training, and what happens while it runs."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import numpy as np

from ..blender.blend_paths import blend_folder, portable
from ..blender.faces import active_logo, logo_names
from ..body.objects import active_body, refusal
from ..exchange.face_lists import read_face_list
from ..files.errors import InputError
from ..poses.export import Export, export, read_export
from ..properties import output_folder, pose_choice, train_request
from ..session import session
from ..trainer.command_lines import train_command
from ..trainer.jobs import Job, TrainingJob, launch, waits
from ..trainer.preferences import chosen_python
from ..ui import props
from ..ui.operator import CloakOperator, push_undo
from . import run_list, runs
from .reasons import (
    attach_reason,
    cancel_reason,
    delete_reason,
    extend_reason,
    kept_reason,
    resume_reason,
    selected_run,
    stop_reason,
    train_reason,
)
from .run_states import FoundTrainer, RunState, request_stop
from .runs import run_of


class CLOAK_OT_train_start(CloakOperator, label="Start", needs=train_reason):
    """Export the body's poses and the active logo, and train the logo's colours in a process of its own"""

    def run(self, context: bpy.types.Context) -> str:
        return start(context)


class CLOAK_OT_train_extend(CloakOperator, label="Extend", needs=extend_reason):
    """Train on from the colours of the chosen run, with the settings above, in a new run: for more steps, another \
detector or other angles. The run itself stays as it is"""

    def run(self, context: bpy.types.Context) -> str:
        return start(context, selected_run(context))


def start(context: bpy.types.Context, begun: RunState | None = None) -> str:
    """Export and train in a new run; from the colours of another run where one is given."""
    obj, settings = active_body(context), context.scene.cloak
    logo = begun.logo if begun and begun.logo in logo_names(obj.data) else active_logo(obj)
    options, python = train_request(settings).options(), chosen_python()
    options += [f"--init={begun.path}"] if begun else []
    if obj.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    _remove_failed_start()
    run = runs.new_run(output_folder(settings), obj.name, logo)
    done = export(context, obj, logo, pose_choice(settings), runs.input_folder(run))
    made_from, _, faces = obj.cloak.made_from.partition("|")
    options += [f"--made-from={made_from}"] if made_from and faces == read_face_list(done.face_list).topology else []
    runs.remember_options(run, options)
    begin(obj, run, done, train_command(python, options, done.scene, done.face_list, run))
    begins = f", from the colours of {begun.title}" if begun else ""
    return f"Training '{logo}' on {done.poses} poses of '{obj.name}' in {run}{begins}{waits(session.jobs[-1])}"


def _remove_failed_start() -> None:
    """Remove what the last Start left if its training never began."""
    for job in session.jobs:
        ended = isinstance(job, TrainingJob) and not job.active
        if ended and not job.run.exists() and runs.input_folder(job.run).is_dir():
            runs.remove(job.run)


class CLOAK_OT_train_cancel(CloakOperator, label="Cancel", needs=cancel_reason):
    """End the job; a training ends after the current step and can be resumed"""

    number: props.whole("Job", "Its place in the queue; -1: the one that runs", -1)

    def run(self, context: bpy.types.Context) -> str:
        job = session.jobs[self.number] if 0 <= self.number < len(session.jobs) else session.job
        if job is None or not job.active:
            raise InputError("Nothing is running")
        job.cancel()
        return f"Stopping: {job.label}"


class CLOAK_OT_train_resume(CloakOperator, label="Resume", needs=resume_reason):
    """Go on with the chosen run from its last checkpoint to its last step, with what it was started with"""

    def run(self, context: bpy.types.Context) -> str:
        obj, state = active_body(context), selected_run(context)
        done = read_export(runs.input_folder(state.path))
        kept = kept_reason(context)
        command = train_command(chosen_python(), list(state.options), done.scene, done.face_list, state.path)
        begin(obj, state.path, done, [*command, "--resume"])
        return kept or f"Resuming {state.path}"


def begin(obj: bpy.types.Object, run: Path, done: Export, command: list[str]) -> None:
    """Launch the training of an export and wire its live colours."""
    watch = Watch(obj, run, read_face_list(done.face_list).ids, done.topology)
    follow(obj, TrainingJob(command, run, done.folder, watch.finish), watch)


def follow(obj: bpy.types.Object, job: TrainingJob, watch: Watch) -> None:
    """Make a training a job, and its run the body's as soon as it runs."""
    job.on_tick = watch.tick
    if launch(job).running:
        watch.wear(obj)
    run_list.refresh(bpy.context)


class Watch:
    """Looks after one training on the main thread: shows live colours, imports the last ones.

    The body is found again by what it is, should the file have been reverted, opened again, or changed.
    """

    def __init__(self, obj: bpy.types.Object, run: Path, face_ids: np.ndarray, topology: str) -> None:
        self._live = runs.LiveColors(obj, run, topology, face_ids)
        self._run, self._name = run, obj.name
        self._trained = face_ids, topology
        self._worn = False
        self._looked = -1
        self._refused = ""
        self._last = time.monotonic()

    def wear(self, obj: bpy.types.Object) -> None:
        """Assign this run to the body."""
        obj.cloak.run, obj.cloak.verdict = portable(str(self._run), blend_folder()), ""
        self._worn = True

    def body(self) -> bpy.types.Object | None:
        """The body, found anew where it is not the one that was there at the start; None where there is none."""
        obj = self._live.object
        if obj is not None and obj.users_scene:
            return obj
        if self._looked == session.mesh_changes:
            return None
        self._looked = session.mesh_changes
        face_ids, topology = self._trained
        found = runs.body_of(self._run, topology)
        if found is not None:
            self._live = runs.LiveColors(found, self._run, topology, face_ids)
            self.wear(found)
        return found

    def tick(self, job: Job) -> None:
        """Called by the timer."""
        if not job.running:
            return
        obj = self.body()
        if obj is None:
            job.notice = f"'{self._name}' was deleted: its training goes on in {self._run.name}. Ctrl Z brings it back"
            return
        if not self._worn:
            self.wear(obj)
        if runs.run_of(obj) != self._run:
            job.notice = f"'{obj.name}' wears another run: choose {self._run.name} in the list to see its colours"
            return
        settings = bpy.context.scene.cloak
        if settings.live and time.monotonic() - self._last >= settings.live_seconds:
            self._refused = refusal(self._live.update, bpy.context)
            self._last = time.monotonic()
        job.notice = self._refused

    def finish(self, job: Job) -> str | None:
        """At the end: refresh the list of runs and import the last colours."""
        run_list.refresh(bpy.context)
        if not (self._run / "colors.npy").exists():
            return None
        self._looked = -1
        obj = self.body()
        try:
            if obj is None:
                raise InputError("the object is gone; open its file and press Load Colours")
            if runs.run_of(obj) != self._run:
                raise InputError(f"'{obj.name}' wears another run; choose {self._run.name} in the list")
            if obj.mode == "EDIT":
                raise InputError("leave Edit Mode (Tab) and press Load Colours")
            runs.import_colors(bpy.context, obj, self._run)
            push_undo("Cloak Colours")
        except InputError as error:
            return f"{job.message}; no colours imported: {error}"
        return None


class CLOAK_OT_run_attach(CloakOperator, label="Attach", needs=attach_reason):
    """Follow a training that this Blender did not start, or lost in a crash: its progress in the panel, its colours \
on the body. When Blender closes it goes on"""

    def run(self, context: bpy.types.Context) -> str:
        run = selected_run(context).path
        face_ids, topology = runs.trained_faces(run)
        obj = runs.body_of(run, topology)
        if obj is None:
            raise InputError(f"No body of this file has the faces that {run.name} is trained on: open its own file")
        context.view_layer.objects.active = obj
        watch = Watch(obj, run, face_ids, topology)
        follow(obj, TrainingJob([], run, runs.side_folder(run), watch.finish, FoundTrainer(run)), watch)
        return f"Following {run.name}"


class CLOAK_OT_run_stop(CloakOperator, label="Stop", needs=stop_reason):
    """End the training of the chosen run after its current step, whoever started it; Resume goes on with it"""

    def run(self, context: bpy.types.Context) -> str:
        run = selected_run(context).path
        job = session.training_of(run)
        if job is not None:
            job.cancel()
        else:
            request_stop(run)
        return f"Stopping {run.name} after its current step"


class CLOAK_OT_run_delete(CloakOperator, label="Delete Run", needs=delete_reason):
    """Delete the folders of the chosen run from the disk; bodies keep the colours they wear. This cannot be undone"""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def run(self, context: bpy.types.Context) -> str:
        run = selected_run(context).path
        runs.remove(run)
        for obj in bpy.data.objects:
            if run_of(obj) == run:
                obj.cloak.run = ""
        run_list.select(context, None)
        run_list.refresh(context)
        return f"Deleted {run}"
