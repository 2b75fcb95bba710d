# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that judge a cloak: its evaluation, and the detector's eye."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..blender.blend_paths import absolute
from ..body.objects import active_body, of_the_body, refusal
from ..poses.poses import PoseChoice
from ..poses.reasons import poses_reason
from ..session import session
from ..trainer.command_lines import cloak_command, detector_options
from ..trainer.jobs import Job, run_cloak
from ..trainer.onlooker import Onlooker
from ..trainer.preferences import local_python
from ..training import run_list
from ..training.detectors import judges
from ..training.runs import input_folder, run_of, side_folder
from ..ui.operator import CloakOperator
from ..ui.window import main_region, redraw
from . import eye
from .evaluations import kept_back, read_evaluation
from .judging import evaluate_options
from .reasons import export_worn, judged_reason


def evaluate_reason(context: bpy.types.Context) -> str:
    """Why the body's run cannot be evaluated."""
    reason = judged_reason(context)
    judging = context.scene.cloak.judging
    if reason or judging.bodies == "KEPT":
        return reason or _folder_reason(judging.backgrounds)
    choice = PoseChoice("RANGE", judging.frame_start, judging.frame_end, judging.frame_step)
    return poses_reason(context, choice) or _folder_reason(judging.backgrounds)


def _folder_reason(path: str) -> str:
    found = absolute(path)
    return "" if not found or Path(found).is_dir() else f"Backgrounds folder {found} does not exist"


@of_the_body
def eye_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the detector cannot look at the body."""
    return poses_reason(context, PoseChoice()) or refusal(judges, context.scene.cloak)


class CLOAK_OT_evaluate(CloakOperator, label="Evaluate", needs=evaluate_reason):
    """Measure the run's colours on bodies, backgrounds and angles that training did not see, all around the body, \
beside controls on the same images. The result is shown here and as a ring around the body"""

    def run(self, context: bpy.types.Context) -> str:
        obj, settings = active_body(context), context.scene.cloak
        run, judging = run_of(obj), settings.judging
        options = evaluate_options(judging, judges(settings), settings.device)
        folder = side_folder(run)
        if judging.bodies == "FRAMES":
            choice = PoseChoice("RANGE", judging.frame_start, judging.frame_end, judging.frame_step)
            scene = folder / "evaluation scene"
            export_worn(context, obj, run, choice, scene)
            options.append(f"--scene={scene}")
        elif not kept_back(run) and (input_folder(run) / "scene").is_dir():
            options.append(f"--scene={input_folder(run) / 'scene'}")
        words, ended = ["evaluate", run, *options], lambda job: _evaluated(job, run)
        return f"Evaluating {run.name}" + run_cloak("Evaluation", words, folder, "evaluate", ended, True)


def _evaluated(job: Job, run: Path) -> str | None:
    found = read_evaluation(run)
    run_list.refresh(bpy.context)
    if found is None:
        return None
    rates = [judged.rates for judged in found.detectors]
    job.is_bad_news = any((rate["logo"][0].value or 0) <= (rate["clothing"][0].value or 0) for rate in rates)
    outcome = "The cloak hides no more than own clothing does" if job.is_bad_news else "Evaluation done"
    return f"{outcome}: {found.describe()}"


class CLOAK_OT_eye(CloakOperator, label="Detector's Eye"):
    """Let the detector look at the body from where you look, or the camera, and draw what it sees over the viewport. \
It goes on looking as you move, and while a training runs, until this is pressed again"""

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        return "" if session.eye is not None else eye_reason(context)

    def run(self, context: bpy.types.Context) -> str:
        if session.eye is not None:
            eye.close_eye()
            redraw()
            return "The detector looks no more"
        obj, settings = active_body(context), context.scene.cloak
        folder = Path(bpy.app.tempdir, "cloak eye")
        folder.mkdir(parents=True, exist_ok=True)
        python = local_python()
        options = lambda specs: [*detector_options(specs), f"--device={settings.device}"]
        start = lambda specs: Onlooker(cloak_command(python, "look", "-", *options(specs)), folder)
        opened = eye.Eye(obj, start, folder, judges(settings))
        if context.area is not None and context.area.type == "VIEW_3D":
            opened.region = main_region(context.area).as_pointer()
        eye.open_eye(opened)
        return f"{', '.join(opened.specs)}: getting ready to look"
