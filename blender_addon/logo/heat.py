# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 2 that ask the detector which faces a logo should take."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np

from ..blender import colors, faces
from ..blender.blend_paths import first_free
from ..blender.colors import HEAT
from ..blender.mesh_arrays import read, write_attribute
from ..body.garments import is_dressed
from ..body.objects import active_body, object_of, topology
from ..exchange.heat import hottest_faces
from ..exchange.scenes import write_scene
from ..files.errors import InputError
from ..files.reading import read_npy
from ..poses.export import export_bodies
from ..properties import pose_choice, settings_of, train_request
from ..result.reasons import heat_reason, heatmap_reason, shown_heat_reason
from ..trainer.command_lines import heatmap_command
from ..trainer.jobs import Job, run_command
from ..trainer.preferences import chosen_python, user_folder
from ..ui.operator import BodyOperator, CloakOperator, push_undo


class CLOAK_OT_heatmap(CloakOperator):
    """Colour the body by how much each face moves the chosen detector's score: a logo pays where it is bright"""

    bl_label = "Heatmap"
    needs = staticmethod(heatmap_reason)

    def run(self, context: bpy.types.Context) -> str:
        obj, settings = active_body(context), settings_of(context)
        if obj.mode == "EDIT":
            bpy.ops.object.mode_set(mode="OBJECT")
        python, request = chosen_python(), train_request(settings)
        folder = first_free(user_folder("heatmap"), "heat")
        write_scene(folder / "scene", export_bodies(context, obj, pose_choice(settings)))
        heat, uid, expected = folder / "heat.npy", obj.session_uid, topology(obj)
        command = heatmap_command(python, request, folder / "scene", heat, folder / "heat.jsonl")
        show = lambda job: _show_heat(job, heat, uid, expected)
        waits = run_command("Heatmap", command, folder, "heatmap", show, "heat.jsonl")
        return f"Measuring which faces move the detector{waits}"


def _show_heat(job: Job, path: Path, uid: int, expected: str) -> str | None:
    if job.state != "done":
        return None
    obj = object_of(uid)
    if obj is None or topology(obj) != expected:
        raise InputError("The body changed while its heat map was made: press Heatmap again")
    show_heat(bpy.context, obj, read_npy(path))
    push_undo("Heatmap")
    shutil.rmtree(path.parent, ignore_errors=True)
    return "Heatmap: bright faces move the detector most"


def show_heat(context: bpy.types.Context, obj: bpy.types.Object, heat: np.ndarray) -> None:
    """Keep heat [F] on the mesh and show it in the viewports."""
    heat = np.asarray(heat, np.float32)[: len(obj.data.polygons)]
    if heat.shape != (len(obj.data.polygons),):
        raise InputError(f"The heat map has {len(heat)} values for {len(obj.data.polygons)} faces: press Heatmap again")
    write_attribute(obj.data, HEAT, "FLOAT", heat)
    colors.write_face_colors(obj, colors.HEATMAP, colors.heat_colors(heat))
    colors.show_attribute(context, obj, colors.HEATMAP)


class CLOAK_OT_heatmap_toggle(BodyOperator):
    """Show the heat map, or give the body its own look, or its cloak, back; the heat stays for New from Heatmap"""

    bl_label = "Toggle Heatmap"
    needs = staticmethod(shown_heat_reason)

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        if colors.shows_heat(obj):
            colors.hide_heat(context, obj, is_dressed(obj))
            return f"'{obj.name}' shows its heat map no more"
        show_heat(context, obj, read(obj.data.attributes[HEAT].data, "value"))
        return f"'{obj.name}' shows its heat map"


class CLOAK_OT_logo_from_heat(BodyOperator):
    """Make a logo of the faces that move the detector most for their size"""

    bl_label = "New from Heatmap"
    needs = staticmethod(heat_reason)

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        attribute = obj.data.attributes.get(HEAT)
        if attribute is None:
            raise InputError(f"'{obj.name}' has no heat map: press Heatmap first")
        if obj.mode == "EDIT":
            raise InputError("Leave Edit Mode (Tab) to take faces from the heat map")
        heat = read(attribute.data, "value")
        ids = hottest_faces(heat, faces.face_areas(obj), settings_of(context).heat_share)
        obj.cloak.logo = faces.new_logo(obj, "Heat", np.isin(np.arange(len(heat)), ids))
        return f"Logo '{obj.cloak.logo}': {len(ids):,} faces"
