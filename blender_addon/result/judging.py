# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 5 that judge a cloak: render check, evaluation, the detector's eye, people; and Try It."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ..blender import colors
from ..blender.blend_paths import absolute, first_free
from ..blender.pictures import new_image, read_picture
from ..body.garments import is_dressed
from ..body.objects import active_body, of_the_body, refusal
from ..files.errors import InputError
from ..files.writing import write_json, written
from ..poses.export import poses_reason, standing_reason
from ..session import session
from ..trainer.jobs import Job, launch, run_cloak, waits
from ..trainer.program import cloak_command, options, require, trainer
from ..training import run_list, runs
from ..training.detectors import judges
from ..training.runs import run_of, side_folder
from ..translations import said
from ..ui.bases import operator
from ..ui.window import areas, in_window, main_region, redraw, tell_status
from . import eye as eyes
from . import render_check as cycles
from .evaluations import (
    ANSWER,
    WEAR,
    by_detector,
    export_worn,
    judged_reason,
    kept_back,
    people_file,
    read_evaluation,
    result_reason,
)


@of_the_body
def check_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why nothing can be rendered and judged."""
    if not is_dressed(obj):
        return f"'{obj.name}' shows its own materials: switch the cloak on first"
    return judged_reason(context) or refusal(judges, context.scene.cloak)


@operator("Render Check", check_reason, trains=True)
def render_check(context: bpy.types.Context) -> str:
    """Render the body in Cycles from the training cameras, with and without the cloak, and let the detector judge"""
    obj, settings = active_body(context), context.scene.cloak
    folder = first_free(side_folder(run_of(obj)), cycles.NAME)
    with written(folder):
        folder.mkdir(parents=True)
    specs, program = judges(settings), trainer()
    angles = tuple(range(settings.angle_first, settings.angle_last + 1, settings.angle_step))
    plan = cycles.Plan(obj.name, folder, angles, absolute(settings.backgrounds))
    images = cycles.image_paths(plan)
    check = lambda spec, image: cloak_command(program, "detectors", "check", spec, "--image", image)
    commands = [cycles.prepare(plan), *(check(spec, image) for spec in specs for image in images)]

    def ended(job: Job) -> str | None:
        if job.state != "done":
            return None
        sights = cycles.verdict(plan, specs, job.outputs[1:])
        job.is_bad_news = not all(map(cycles.holds, by_detector(sights).values()))
        run_list.refresh(bpy.context)
        return cycles.describe_all(sights)

    job = launch(Job("Render check", commands, folder, "check", ended))
    return f"Rendering {len(images)} images into {folder}" + waits(job)


AROUND = 180  # an evaluation all around goes this many degrees to either side
BARE = 256  # most empty backgrounds that are checked for false alarms


def evaluate_reason(context: bpy.types.Context) -> str:
    """Why nothing can be evaluated."""
    judging = context.scene.cloak.judging
    reason = judged_reason(context) or (poses_reason(context, judging.frames) if judging.frames else "")
    folder = absolute(judging.backgrounds)
    return reason or ("" if not folder or Path(folder).is_dir() else f"Backgrounds folder {folder} does not exist")


@operator("Evaluate", evaluate_reason, trains=True)
def evaluate(context: bpy.types.Context) -> str:
    """Measure the run's colours on bodies, backgrounds and angles that training did not see, all around the body, \
beside controls on the same images. The result is shown here and as a ring around the body"""
    obj, settings = active_body(context), context.scene.cloak
    run, judging = run_of(obj), settings.judging
    azimuths = len(range(-AROUND, AROUND, judging.angle))
    angles = f"{-AROUND}:{-AROUND + (azimuths - 1) * judging.angle}:{judging.angle}"
    bare = min(BARE, judging.images)
    words = ["evaluate", run, *options(judges(settings), angles=angles, bare=bare, device=settings.device)]
    # One pose must do for all the images; of more poses some are drawn.
    words += [f"--images-per-view={math.ceil(judging.images / azimuths)}", f"--most-images={judging.images}"]
    words.append(judging.backgrounds_option)
    folder = side_folder(run)
    if judging.frames:
        scene = folder / "evaluation scene"
        export_worn(context, obj, run, judging.frames, scene)
        words.append(f"--scene={scene}")
    elif not kept_back(run) and runs.exported_scene(run):
        words.append(f"--scene={runs.exported_scene(run)}")

    def ended(job: Job) -> str | None:
        found = read_evaluation(run)
        run_list.refresh(bpy.context)
        if found is None:
            return None
        rates = {(r.spec, r.name): r.value or 0 for r in found.rates if r.threshold == found.threshold}
        job.is_bad_news = any(rates[spec, "logo"] <= rates[spec, "clothing"] for spec in found.detectors)
        outcome = "The cloak hides no more than own clothing does" if job.is_bad_news else "Evaluation done"
        return f"{outcome}: {found.describe()}"

    return f"Evaluating {run.name}" + run_cloak("Evaluation", words, folder, "evaluate", ended, True)


@operator(
    "Detector's Eye",
    lambda context: "" if session.eye else standing_reason(context) or refusal(judges, context.scene.cloak),
    trains=True,
)
def eye(context: bpy.types.Context) -> str:
    """Let the detector look at the body from where you look, or the camera, and draw what it sees over the viewport. \
It goes on looking as you move, and while a training runs, until this is pressed again"""
    if session.eye is not None:
        session.eye.cancel()
        redraw()
        return "The detector looks no more"
    folder = Path(bpy.app.tempdir, "cloak eye")
    folder.mkdir(parents=True, exist_ok=True)
    in_viewport = context.area is not None and context.area.type == "VIEW_3D"
    region = main_region(context.area).as_pointer() if in_viewport else 0
    launch(eyes.Eye(active_body(context), context.scene.cloak, folder, region))
    return f"{', '.join(session.eye.specs)}: getting ready to look"


def people_reason(context: bpy.types.Context) -> str:
    """Why people in photographs cannot wear the run."""
    settings = context.scene.cloak
    reason = result_reason(context) or refusal(people_file, settings.judging.people) or refusal(judges, settings)
    if reason:
        return reason
    obj = active_body(context)
    run = run_of(obj)
    # They are fitted with the faces of Cloak's own people.
    if obj.cloak.made_from or kept_back(run) or (run / "zoo.json").is_file() or (run / "cloth.png").is_file():
        return ""
    return (
        f"People in photographs wear what was trained on Cloak's own people, and '{obj.name}' is none of them: "
        "train on the sample body, or carry the colours over (cloak logo transfer)"
    )


@operator("Wear", people_reason, trains=True)
def wear(context: bpy.types.Context) -> str:
    """Lay the run's colours onto the people of photographs, and let the detectors judge them before and after"""
    settings, run = context.scene.cloak, run_of(active_body(context))
    people, place = people_file(settings.judging.people), first_free(side_folder(run), WEAR)
    words = ["wear", run, *options(judges(settings), people=people, device=settings.device), "--out", place]

    def ended(job: Job) -> str:
        try:
            record = json.loads(job.outputs[-1])
            count = int(record["people"])
        except (ValueError, KeyError, TypeError):
            raise InputError("Wear: the trainer's answer is not understood; see wear.log") from None
        place.mkdir(exist_ok=True)
        write_json(place / ANSWER, record)
        return f"{count} people wear it"

    waiting = run_cloak("Wear", words, side_folder(run), "wear", ended)
    return f"{run.name} is put on by the people of {people.name}{waiting}"


# --- Try It: one button from an empty file to a picture before and after; the status bar says how far it is ----------

STEPS = 100
PICTURE = "{:.2f} before, {:.2f} after: scores, reported from {:g}"  # its beginning is seen in the editor's header


@operator("Try It", trains=True)
def try_it(context: bpy.types.Context) -> str:
    """Add the sample body, train its front for a short while against the built-in detector, and render it with the \
cloak and without, for the detector to judge. Takes some minutes; Blender stays usable"""
    require(options(judges(context.scene.cloak)))
    bpy.ops.cloak.add_sample_body()
    _then("Sample body", _train)
    return "Sample body, short training, check: the status bar shows how far it is"


def _then(label: str, following: Callable[[], None]) -> None:
    """Let a step follow when the job of this label has ended well; until then the status bar shows it."""
    job = session.job_of(label)
    end, tick = job.on_end, job.on_tick

    def ticked(job: Job) -> None:
        if job.active:
            tell_status(f"{label}: {said(job.describe())}")
        if tick is not None:
            tick(job)

    def ended(job: Job) -> str | None:
        tell_status("")
        message = end(job) if end is not None else None
        if job.state == "done":
            following()
        return message

    job.on_end, job.on_tick = ended, ticked


def _train() -> None:
    settings = bpy.context.scene.cloak
    settings.steps, settings.pose_source = STEPS, "CURRENT"
    settings.angle_first, settings.angle_last, settings.angle_step = -10, 10, 20  # degrees
    active_body(bpy.context).cloak.logo = "front"  # the chest alone hides nobody in so few steps
    bpy.ops.cloak.train_start()
    _then("Training", _check)


def _check() -> None:
    """Show the cloak as the detector saw it, and let the detector judge renders of it."""
    colors.use_standard_view(bpy.context.scene)
    for _, area in areas("VIEW_3D"):
        area.spaces.active.shading.light = "FLAT"
    active_body(bpy.context).select_set(False)  # its outline would hide the cloak
    bpy.ops.cloak.render_check()
    _then("Render check", _compare)


def _compare() -> None:
    """Show the first render without the cloak, and beside it the one with it; its name has the scores."""
    sights = cycles.last_check(side_folder(run_of(active_body(bpy.context))))
    before, after = (next(sight for sight in sights if sight.kind == kind) for kind in ("clothing", "cloak"))
    title = PICTURE.format(before.score, after.score, after.threshold)
    image = new_image(title, np.concatenate([read_picture(s.picture)[..., :3] for s in (before, after)], axis=1))
    image.pack()
    if in_window(bpy.ops.wm.window_new):  # as Blender shows a render
        area = bpy.context.window_manager.windows[-1].screen.areas[0]
        area.ui_type = "IMAGE_EDITOR"
        area.spaces.active.image = image
