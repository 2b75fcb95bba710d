# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 5: colours on and off, colour management, report, and what judges a cloak."""

import functools
import json
import math
import shutil
from pathlib import Path

import bpy
from bpy.props import EnumProperty

from ..blender import colors
from ..blender.blend_paths import absolute, first_free
from ..blender.mesh_arrays import mode_reason, topology
from ..body.garments import is_dressed, undress
from ..body.objects import active_body, body_reason, object_of, of_the_body, refusal
from ..body.samples import ASSETS, add_people
from ..exchange.scenes import read_scene
from ..files.errors import InputError
from ..files.reading import read_json
from ..files.writing import write_json, written
from ..poses.export import poses_reason
from ..poses.poses import PoseChoice
from ..properties import output_folder
from ..session import session
from ..trainer.command_lines import SAMPLES, cloak_command, options
from ..trainer.jobs import Job, launch, run_cloak, waits
from ..trainer.preferences import trainer
from ..training import run_list, runs
from ..training.detectors import judges
from ..training.runs import run_of, side_folder
from ..translations import said
from ..ui import props
from ..ui.operator import WITH_UNDO, BodyOperator, CloakOperator
from ..ui.window import main_region, redraw
from . import eye, render_check
from .evaluations import kept_back, read_evaluation
from .reasons import ANSWER, WEAR, export_worn, foreign_reason, judged_reason, people_file, result_reason


def wear_reason(context: bpy.types.Context) -> str:
    """Why the body cannot be given, or be rid of, the colours."""
    return result_reason(context) or mode_reason(active_body(context), "Leave {mode} to see the colours on the model")


@of_the_body
def report_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there is no report to open."""
    run = run_of(obj)
    if run is None:
        return "Choose a run in the list first"
    known = (run / "report.html").is_file() or (run / "config.json").is_file()
    return "" if known else f"{run}: not a run folder (no config.json in it), so there is nothing to report"


class CLOAK_OT_result_load(BodyOperator, label="Load Colours", needs=wear_reason):
    """Bring the colours of the run folder onto the model"""

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        count = runs.import_colors(context, obj, run_of(obj))
        return f"{count:,} faces of '{obj.name}' wear the trained colours"


@functools.cache  # Blender keeps no copy of a menu's words: they must live on
def ready_cloaks() -> list[tuple[str, str, str]]:
    """The cloaks that come with the extension: name, title, and what they are."""
    paths = sorted(ASSETS.glob("*/zoo.json"))
    return [(path.parent.name, path.parent.name, str(read_json(path).get("about", ""))) for path in paths]


class CLOAK_OT_ready_cloak(CloakOperator, label="Ready Cloak"):
    """Wear a cloak that comes with Cloak, on the sample body, which is added where the active body is another. The \
run is copied to the output folder"""

    bl_options = WITH_UNDO

    cloak: EnumProperty(name="Ready Cloak", description="Which one to wear", items=lambda _, context: ready_cloaks())

    def run(self, context: bpy.types.Context) -> str:
        source = ASSETS / self.cloak
        _, expected = runs.trained_faces(source)
        if body_reason(context) or topology(active_body(context)) != expected:
            bodies = read_scene(ASSETS / "sample")
            add_people(context, bodies, False, "Sample Body").cloak.made_from = f"{SAMPLES['BARE']}|{bodies.topology}"
        obj, place = active_body(context), first_free(output_folder(context.scene.cloak), self.cloak)
        with written(place):
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copytree(source, place)
        return runs.wear_run(context, obj, place)


class CLOAK_OT_result_toggle(BodyOperator, label="Toggle Cloak", needs=wear_reason):
    """Switch between the cloak and the body's own materials"""

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        if is_dressed(obj):
            undress(obj)
            colors.show_attribute(obj)
            return f"'{obj.name}' shows its own materials"
        runs.import_colors(context, obj, run_of(obj))
        return f"'{obj.name}' wears the cloak"


class CLOAK_OT_explain(CloakOperator, label="Explain"):
    """What a figure of the panel means"""

    tip: props.text("Tip", "What the figure means")

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return said(properties.tip)

    def run(self, context: bpy.types.Context) -> str:
        return self.tip


class CLOAK_OT_use_standard_view(CloakOperator, label="Use Standard"):
    """Show the trained colours as the detector saw them: Standard colours and, in a Solid viewport, flat light"""

    bl_options = WITH_UNDO

    def run(self, context: bpy.types.Context) -> str:
        colors.use_standard_view(context.scene)
        if lit := colors.light_reason(context.space_data):
            context.space_data.shading.light = "FLAT"
        return "View transform: Standard" + (", flat light" if lit else "")


class CLOAK_OT_open_report(CloakOperator, label="Open Report", needs=report_reason, trains=True):
    """Open the run's report in the web browser, after making it if need be"""

    def run(self, context: bpy.types.Context) -> str:
        run = run_of(active_body(context))
        report = run / "report.html"
        if report.exists():
            return _open(report)
        ended = lambda job: _open(report) if report.exists() else None
        return "Making the report" + run_cloak("Report", ("report", run), runs.side_folder(run), "report", ended)


def _open(report: Path) -> str:
    if not bpy.app.background:
        bpy.ops.wm.url_open(url=report.as_uri())
    return f"Opened {report}"


# --- what judges a cloak ---------------------------------------------------------------------------------------------


@of_the_body
def check_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the cloak cannot be checked in Cycles."""
    if not is_dressed(obj):
        return f"'{obj.name}' shows its own materials: switch the cloak on first"
    return judged_reason(context) or refusal(judges, context.scene.cloak)


class CLOAK_OT_render_check(CloakOperator, label="Render Check", needs=check_reason, trains=True):
    """Render the body in Cycles from the training cameras, with and without the cloak, and let the detector judge"""

    def run(self, context: bpy.types.Context) -> str:
        obj, settings = active_body(context), context.scene.cloak
        folder = first_free(side_folder(run_of(obj)), render_check.NAME)
        with written(folder):
            folder.mkdir(parents=True)
        specs, program = judges(settings), trainer()
        angles = tuple(range(settings.angle_first, settings.angle_last + 1, settings.angle_step))
        plan = render_check.Plan(obj.name, folder, angles, absolute(settings.backgrounds))
        images = render_check.image_paths(plan)
        check = lambda spec, image: cloak_command(program, "detectors", "check", spec, "--image", image)
        commands = [render_check.prepare(plan), *(check(spec, image) for spec in specs for image in images)]
        uid = obj.session_uid
        job = launch(Job("Render check", commands, folder, "check", lambda job: _judge(job, plan, specs, uid)))
        return f"Rendering {len(images)} images into {folder}" + waits(job)


def _judge(job: Job, plan: render_check.Plan, specs: tuple[str, ...], uid: int) -> str | None:
    if job.state != "done":
        return None
    found, obj = render_check.verdicts(plan, specs, job.outputs[1:]), object_of(uid)
    job.is_bad_news = not all(verdict.holds for verdict in found)
    if obj is not None:
        obj.cloak.verdict = render_check.describe_all(found)
    run_list.refresh(bpy.context)
    return render_check.describe_all(found)


AROUND = 180  # an evaluation all around goes this many degrees to either side
BARE = 256  # most empty backgrounds that are checked for false alarms


def evaluate_reason(context: bpy.types.Context) -> str:
    """Why the body's run cannot be evaluated."""
    judging = context.scene.cloak.judging
    reason = judged_reason(context) or (poses_reason(context, judging.frames) if judging.frames else "")
    folder = absolute(judging.backgrounds)
    return reason or ("" if not folder or Path(folder).is_dir() else f"Backgrounds folder {folder} does not exist")


class CLOAK_OT_evaluate(CloakOperator, label="Evaluate", needs=evaluate_reason, trains=True):
    """Measure the run's colours on bodies, backgrounds and angles that training did not see, all around the body, \
beside controls on the same images. The result is shown here and as a ring around the body"""

    def run(self, context: bpy.types.Context) -> str:
        obj, settings = active_body(context), context.scene.cloak
        run, judging = run_of(obj), settings.judging
        azimuths = len(range(-AROUND, AROUND, judging.angle))
        angles = f"{-AROUND}:{-AROUND + (azimuths - 1) * judging.angle}:{judging.angle}"
        bare, device = min(BARE, judging.images), settings.device
        words = ["evaluate", run, *options(judges(settings), angles=angles, bare=bare, device=device)]
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
        ended = lambda job: _evaluated(job, run)
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


class CLOAK_OT_eye(CloakOperator, label="Detector's Eye", trains=True):
    """Let the detector look at the body from where you look, or the camera, and draw what it sees over the viewport. \
It goes on looking as you move, and while a training runs, until this is pressed again"""

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        return "" if session.eye else poses_reason(context, PoseChoice()) or refusal(judges, context.scene.cloak)

    def run(self, context: bpy.types.Context) -> str:
        if session.eye is not None:
            eye.close_eye()
            redraw()
            return "The detector looks no more"
        folder = Path(bpy.app.tempdir, "cloak eye")
        folder.mkdir(parents=True, exist_ok=True)
        in_viewport = context.area is not None and context.area.type == "VIEW_3D"
        region = main_region(context.area).as_pointer() if in_viewport else 0
        session.eye, session.eye_closed_because = eye.Eye(active_body(context), context.scene.cloak, folder, region), ""
        if not bpy.app.background:
            bpy.app.timers.register(eye.tick)
        return f"{', '.join(session.eye.specs)}: getting ready to look"


class CLOAK_OT_wear(CloakOperator, label="Wear", trains=True):
    """Lay the run's colours onto the people of photographs, and let the detectors judge them before and after"""

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        settings = context.scene.cloak
        reason = result_reason(context) or refusal(people_file, settings.judging.people)
        return reason or refusal(judges, settings) or foreign_reason(active_body(context))

    def run(self, context: bpy.types.Context) -> str:
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
