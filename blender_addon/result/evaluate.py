# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that judge a cloak: its evaluation, and the detector's eye."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..body.objects import active_body
from ..poses.poses import PoseChoice
from ..properties import settings_of
from ..session import session
from ..trainer.command_lines import evaluate_command, look_command
from ..trainer.jobs import Job, run_command
from ..trainer.onlooker import Onlooker
from ..trainer.preferences import chosen_python, local_python
from ..training import run_list
from ..training.detectors import judges
from ..training.runs import input_folder, run_of, side_folder
from ..ui.operator import CloakOperator
from ..ui.window import redraw
from . import eye
from .evaluations import kept_back, read_evaluation
from .judging import evaluate_options
from .reasons import evaluate_reason, eye_reason
from .worn_scenes import export_worn


class CLOAK_OT_evaluate(CloakOperator):
    """Measure the run's colours on bodies, backgrounds and angles that training did not see, all around the body, \
beside controls on the same images. The result is shown here and as a ring around the body"""

    bl_label = "Evaluate"
    needs = staticmethod(evaluate_reason)

    def run(self, context: bpy.types.Context) -> str:
        obj, settings = active_body(context), settings_of(context)
        run, python, judging = run_of(obj), chosen_python(), settings.judging
        options = evaluate_options(judging, judges(settings), settings.device)
        folder = side_folder(run)
        if judging.bodies == "FRAMES":
            choice = PoseChoice("RANGE", judging.frame_start, judging.frame_end, judging.frame_step)
            scene = folder / "evaluation scene"
            export_worn(context, obj, run, choice, scene)
            options.append(f"--scene={scene}")
        elif not kept_back(run) and (input_folder(run) / "scene").is_dir():
            options.append(f"--scene={input_folder(run) / 'scene'}")
        events = "evaluate.jsonl"
        command, ended = evaluate_command(python, run, options, folder / events), lambda job: _evaluated(job, run)
        return f"Evaluating {run.name}" + run_command("Evaluation", command, folder, "evaluate", ended, events)


def _evaluated(job: Job, run: Path) -> str | None:
    found = read_evaluation(run) if job.state == "done" else None
    run_list.refresh(bpy.context)
    if found is None:
        return None
    rates = [judged.rates for judged in found.detectors]
    job.is_bad_news = any((rate["logo"][0].value or 0) <= (rate["clothing"][0].value or 0) for rate in rates)
    outcome = "The cloak hides no more than own clothing does" if job.is_bad_news else "Evaluation done"
    return f"{outcome}: {found.describe()}"


class CLOAK_OT_eye(CloakOperator):
    """Let the detector look at the body from where you look, or the camera, and draw what it sees over the viewport. \
It goes on looking as you move, and while a training runs, until this is pressed again"""

    bl_label = "Detector's Eye"

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        return "" if session.eye is not None else eye_reason(context)

    def run(self, context: bpy.types.Context) -> str:
        if session.eye is not None:
            eye.close_eye()
            redraw()
            return "The detector looks no more"
        obj, settings = active_body(context), settings_of(context)
        folder = Path(bpy.app.tempdir, "cloak eye")
        folder.mkdir(parents=True, exist_ok=True)
        python = local_python()
        start = lambda specs: Onlooker(look_command(python, specs, settings.device), folder)
        opened = eye.Eye(obj, start, folder, judges(settings))
        if context.area is not None and context.area.type == "VIEW_3D":
            opened.region = next(r.as_pointer() for r in context.area.regions if r.type == "WINDOW")
        eye.open_eye(opened)
        return f"{', '.join(opened.specs)}: getting ready to look"
