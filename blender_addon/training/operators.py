# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 4: start, extend, cancel and resume a training, and why they cannot run now ("": they can)."""

from functools import partial
from pathlib import Path

import bpy

from ..blender.faces import active_logo, logo_names
from ..body.objects import active_body, body_reason, logo_reason, refusal
from ..exchange.face_lists import read_face_list
from ..files.errors import InputError
from ..files.writing import written
from ..poses.export import export, poses_reason, read_export
from ..properties import output_folder, pose_choice, train_options
from ..session import session
from ..trainer.jobs import Job, TrainingJob, launch, waits
from ..trainer.program import differing_options, require, train_command, trainer
from ..ui import props
from ..ui.bases import operator
from . import run_list, runs
from .run_list import DONE, RUNNING, FoundTrainer, RunState, read_state
from .runs import run_of


def train_reason(context: bpy.types.Context) -> str:
    """Why no training can start."""
    reason = logo_reason(context) or poses_reason(context)
    return reason or refusal(train_options, context.scene.cloak)


def selected_run(context: bpy.types.Context) -> RunState | None:
    """Read the state of the run that is chosen in the list."""
    chosen = run_list.selected_path(context)
    return read_state(Path(chosen)) if chosen else None


def kept_reason(context: bpy.types.Context) -> str:
    """Which of the chosen run's options Resume keeps although the panel differs; "" if none."""
    state = selected_run(context)
    if state is None or run_reason(context, "resumed") or refusal(train_options, context.scene.cloak):
        return ""
    kept = differing_options(list(state.options), train_options(context.scene.cloak))
    return f"Resume keeps what {state.title} began with: {kept}; Extend takes the panel's settings" if kept else ""


def run_reason(context: bpy.types.Context, action: str) -> str:
    """Why the run that is chosen in the list cannot be "extended", "resumed", "stopped", "followed" or "deleted"."""
    state = selected_run(context)
    if action in ("extended", "resumed") and body_reason(context):
        return body_reason(context)
    if state is None:
        return "Choose a run in the list first"
    if not (state.path.is_dir() or runs.input_folder(state.path).is_dir()):
        return f"{state.path} is gone: choose another run"
    if action in ("stopped", "followed") and state.state != RUNNING:
        return f"{state.title} is not being trained"
    if action == "followed":
        return f"{state.title} is followed already" if session.training_of(state.path) else ""
    if action == "resumed" and state.state == RUNNING:
        return f"{state.title} is being trained: Attach follows it"
    if action == "resumed" and state.state == DONE:
        return f"{state.title} is done ({state.progress.describe()}): Extend trains on from its colours"
    if action == "resumed" and not state.path.is_dir():
        return f"{state.title} never began, so there is nothing to go on with: press Start"
    if action == "resumed" and not state.options:
        return f"{state.path}.input, which the add-on keeps for Resume, is not there: press Start, or Extend"
    if action == "extended" and train_reason(context):
        return train_reason(context)
    if action in ("extended", "deleted") and state.state == RUNNING:
        return f"{state.title} is being trained: stop it first"
    colored = action != "extended" or (state.path / "colors.npy").is_file()
    return "" if colored else f"{state.title} has no colours yet"


@operator("Start", train_reason, trains=True)
def train_start(context: bpy.types.Context) -> str:
    """Export the body's poses and the active logo, and train the logo's colours in a process of its own"""
    return start(context)


@operator("Extend", partial(run_reason, action="extended"), trains=True)
def train_extend(context: bpy.types.Context) -> str:
    """Train on from the colours of the chosen run, with the settings above, in a new run: for more steps, another \
detector or other angles. The run itself stays as it is"""
    return start(context, selected_run(context))


def start(context: bpy.types.Context, begun: RunState | None = None) -> str:
    """Export and train in a new run; from the colours of another run where one is given."""
    obj, settings = active_body(context), context.scene.cloak
    logo = begun.logo if begun and begun.logo in logo_names(obj.data) else active_logo(obj)
    options, program = train_options(settings), trainer()
    options += [f"--init={begun.path}"] if begun else []
    require(options)
    if obj.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for job in session.jobs:
        if isinstance(job, TrainingJob) and not job.active and not job.run.exists():
            runs.remove(job.run)  # what the last Start left whose training never began
    run = runs.new_run(output_folder(settings), obj.name, logo)
    done = export(context, obj, logo, pose_choice(settings), runs.input_folder(run))
    made_from, _, faces = obj.cloak.made_from.partition("|")
    options += [f"--made-from={made_from}"] if made_from and faces == read_face_list(done.face_list).topology else []
    runs.remember_options(run, options)
    command = train_command(program, options, done.scene, done.face_list, run)
    follow(obj, TrainingJob(command, run, done.folder))
    begins = f", from the colours of {begun.title}" if begun else ""
    return f"Training '{logo}' on {done.poses} poses of '{obj.name}' in {run}{begins}{waits(session.jobs[-1])}"


ANGLES = {"FRONT": (-10, 10, 5), "HALF": (-90, 90, 15), "AROUND": (-180, 165, 15)}
"""First, last and step of the presets, degrees."""


@operator(
    "Set Angles",
    undo=True,
    angles=props.choice(
        "Angles",
        "Which azimuths to train at",
        ("FRONT", "Front", "The front, as in the paper: -10 to 10 degrees"),
        ("HALF", "Half Around", "Front and both sides: -90 to 90 degrees"),
        ("AROUND", "All Around", "From everywhere: -180 to 165 degrees"),
    ),
)
def set_angles(context: bpy.types.Context, angles: str) -> str:
    """Set the training's angles"""
    settings = context.scene.cloak
    settings.angle_first, settings.angle_last, settings.angle_step = ANGLES[angles]
    return ""


@operator(
    "Cancel",
    lambda context: "" if any(job.active for job in session.jobs) else "Nothing is running",
    number=props.whole("Job", "Its place in the queue; -1: the one that runs", -1),
)
def train_cancel(context: bpy.types.Context, number: int) -> str:
    """End the job; a training ends after the current step and can be resumed"""
    job = session.jobs[number] if 0 <= number < len(session.jobs) else session.job
    if job is None or not job.active:
        raise InputError("Nothing is running")
    job.cancel()
    return f"Stopping: {job.label}"


@operator("Resume", partial(run_reason, action="resumed"), trains=True)
def train_resume(context: bpy.types.Context) -> str:
    """Go on with the chosen run from its last checkpoint to its last step, with what it was started with"""
    obj, state = active_body(context), selected_run(context)
    done = read_export(runs.input_folder(state.path))
    kept = kept_reason(context)
    command = train_command(trainer(), list(state.options), done.scene, done.face_list, state.path)
    follow(obj, TrainingJob([*command, "--resume"], state.path, done.folder))
    return kept or f"Resuming {state.path}"


def follow(obj: bpy.types.Object, job: TrainingJob) -> None:
    """Launch a training, show its colours on the body, and make its run the body's as soon as it runs."""
    live = runs.LiveColors(obj, job.run)

    def ended(job: Job) -> str | None:
        run_list.refresh(bpy.context)
        return live.finish(job)

    job.on_end, job.on_tick = ended, live.tick
    if launch(job).running:
        live.give(obj)
    run_list.refresh(bpy.context)


@operator("Attach", partial(run_reason, action="followed"))
def run_attach(context: bpy.types.Context) -> str:
    """Follow a training that this Blender did not start, or lost in a crash: its progress in the panel, its colours \
on the body. When Blender closes it goes on"""
    run = selected_run(context).path
    obj = runs.body_of(run, runs.trained_faces(run)[1])
    if obj is None:
        raise InputError(f"No body of this file has the faces that {run.name} is trained on: open its own file")
    context.view_layer.objects.active = obj
    follow(obj, TrainingJob([], run, runs.side_folder(run), FoundTrainer(run)))
    return f"Following {run.name}"


@operator("Stop", partial(run_reason, action="stopped"))
def run_stop(context: bpy.types.Context) -> str:
    """End the training of the chosen run after its current step, whoever started it; Resume goes on with it"""
    run = selected_run(context).path
    if job := session.training_of(run):
        job.cancel()
    else:
        with written(run / "cancel"):
            (run / "cancel").touch()
    return f"Stopping {run.name} after its current step"


@operator("Delete Run", partial(run_reason, action="deleted"), confirm=True)
def run_delete(context: bpy.types.Context) -> str:
    """Delete the folders of the chosen run from the disk; bodies keep the colours they wear. This cannot be undone"""
    run = selected_run(context).path
    runs.remove(run)
    for obj in bpy.data.objects:
        if run_of(obj) == run:
            obj.cloak.run = ""
    run_list.select(context, None)
    run_list.refresh(context)
    return f"Deleted {run}"
