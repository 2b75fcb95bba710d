# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 5: colours on and off, colour management, report."""

import functools
import shutil
from pathlib import Path

import bpy
from bpy.props import EnumProperty

from ..blender import colors
from ..blender.blend_paths import first_free
from ..blender.mesh_arrays import mode_reason, topology
from ..body.garments import is_dressed, undress
from ..body.objects import active_body, body_reason, of_the_body
from ..body.samples import ASSETS, add_people
from ..exchange.scenes import read_scene
from ..files.reading import read_json
from ..files.writing import written
from ..properties import output_folder
from ..trainer.jobs import run_cloak
from ..trainer.program import SAMPLES
from ..training import runs
from ..training.runs import run_of
from ..translations import said
from ..ui import props
from ..ui.operator import WITH_UNDO, BodyOperator, CloakOperator
from .reasons import result_reason


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
