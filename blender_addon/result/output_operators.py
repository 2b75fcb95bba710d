# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that make something of a run to take along, and open it."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.props import IntProperty

from ..blender import colors
from ..body.objects import active_body
from ..exchange.bodies import Bodies
from ..files.errors import InputError
from ..poses.poses import PoseChoice
from ..properties import settings_of
from ..trainer.command_lines import film_command, print_command
from ..trainer.jobs import Job, run_command
from ..trainer.preferences import chosen_python
from ..training.runs import input_folder, run_of, side_folder
from ..ui.operator import BodyOperator, CloakOperator
from . import bake, outputs
from .judging import backgrounds_option
from .reasons import camera_film_reason, film_reason, made_reason
from .viewpoints import middle_of, of_camera
from .worn_scenes import export_worn


class CLOAK_OT_print_sheets(CloakOperator):
    """Lay the logo out flat at true size: sheets to print and cut (PDF), a texture, and the body with it (GLB, OBJ)"""

    bl_label = "Print Sheets"
    needs = staticmethod(film_reason)

    def run(self, context: bpy.types.Context) -> str:
        obj, python = active_body(context), chosen_python()
        run = run_of(obj)
        place, scene = outputs.new_place(run, outputs.SHEETS), input_folder(run) / "scene"
        if not scene.is_dir():  # a run of the command line
            scene = side_folder(run) / "print scene"
            export_worn(context, obj, run, PoseChoice(), scene)
        command = print_command(python, run, scene, place)
        waits = run_command(self.bl_label, command, side_folder(run), "print", lambda job: _told(job, place))
        return f"Laying the logo out in {place}{waits}"


class CLOAK_OT_turntable(CloakOperator):
    """Film the body as it stands from all around, in own clothing and in the cloak, with what the detector sees"""

    bl_label = "Turntable"
    needs = staticmethod(film_reason)

    def run(self, context: bpy.types.Context) -> str:
        seconds = settings_of(context).judging.film_seconds
        return film(context, self.bl_label, outputs.TURNTABLE, ["--camera=orbit", f"--seconds={seconds:g}"])


class CLOAK_OT_film(CloakOperator):
    """Film the body along the way of the scene's camera, over the scene's frames, in own clothing and in the cloak, \
with what the detector sees. The camera looks at the middle of the body, which with Poses > Current Pose stands still"""

    bl_label = "Film with Camera"
    needs = staticmethod(camera_film_reason)

    def run(self, context: bpy.types.Context) -> str:
        obj, scene = active_body(context), context.scene
        view = of_camera(scene, middle_of(obj), 1 / scene.unit_settings.scale_length)
        choice, still = PoseChoice(), settings_of(context).pose_source == "CURRENT"
        if not still:
            choice = PoseChoice("RANGE", scene.frame_start, scene.frame_end, 1)
        options = [f"--field-of-view={view.field_of_view:.4f}"]
        if not still:
            options.append(f"--poses-per-second={scene.render.fps / scene.render.fps_base:g}")
        return film(context, self.bl_label, outputs.FILM, options, choice)


def film(
    context: bpy.types.Context, label: str, name: str, options: list[str], choice: PoseChoice | None = None
) -> str:
    """Export the poses and film them; by the scene's camera where the options name none."""
    obj, settings = active_body(context), settings_of(context)
    run, python = run_of(obj), chosen_python()
    suffix = {"png": ""}.get(settings.judging.film_format, f".{settings.judging.film_format}")
    place, folder = outputs.new_place(run, name, suffix), side_folder(run)
    if obj.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    scene = folder / f"{name} scene"
    bodies = export_worn(context, obj, run, choice or PoseChoice(), scene)
    if not any(word.startswith("--camera=") for word in options):
        outputs.write_camera(context, folder / f"{name}.csv", middle_of_motion(bodies))
        options = [*options, f"--camera={folder / name}.csv"]
    options = [*options, f"--fps={outputs.film_fps(context.scene, suffix):g}", backgrounds_option(settings.judging)]
    options, events = [*options, f"--device={settings.device}"], f"{name}.jsonl"
    command = film_command(python, run, scene, options, place, folder / events)
    return f"Filming into {place}" + run_command(label, command, folder, name, lambda job: _told(job, place), events)


def middle_of_motion(bodies: Bodies) -> np.ndarray:
    """[3] what the film's camera looks at: the mean of the poses' middles."""
    return ((bodies.vertices.min(1).astype(float) + bodies.vertices.max(1)) / 2).mean(0)


def _told(job: Job, place: Path) -> str | None:
    # Its name alone: in the panel the way there takes three lines, and the list below opens it.
    return f"Wrote {place.name}" if job.state == "done" else None


class CLOAK_OT_bake(BodyOperator):
    """Bake the trained colours to an image and make a material of it that is an asset. Where the body has no UV map, \
or one with too little room, Cloak makes one of its own"""

    bl_label = "Bake to Image"

    size: IntProperty(name="Size", description="Texels along each side", default=2048, min=16, max=8192)

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        reason = BodyOperator.needs(context)
        if reason or colors.CLOAK in context.object.data.color_attributes:
            return reason
        return "Train, or load colours, first"

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        self.show(0.3)
        done = bake.bake(obj, self.size)
        material = bake.baked_material(done.image, done.uv_map)
        faces = f"{done.off:,} of {len(obj.data.polygons):,} faces are off by more than 4/255"
        made = f"Image and material '{material.name}' on UV map '{done.uv_map}'; {faces}"
        return made if done.off_before is None else f"{made} ({done.off_before:,} on the body's own map)"


class CLOAK_OT_show_made(CloakOperator):
    """Open it with the program that the system has for it"""

    bl_label = "Open"
    needs = staticmethod(made_reason)

    path: bpy.props.StringProperty(name="Path", description="What to open")

    def run(self, context: bpy.types.Context) -> str:
        if not Path(self.path).exists():
            raise InputError(f"{self.path} is gone")
        if not bpy.app.background:
            bpy.ops.wm.path_open(filepath=self.path)
        return f"Opened {self.path}"
