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
from ..blender.mesh_arrays import read, topology, write_attribute
from ..body.garments import is_dressed
from ..body.objects import active_body, object_of, of_the_body, refusal, require_upright
from ..exchange.heat import hottest_faces
from ..exchange.scenes import write_scene
from ..files.errors import InputError
from ..files.reading import read_npy
from ..poses.export import export_bodies
from ..properties import pose_choice, train_request
from ..trainer.command_lines import TrainRequest, detector_options
from ..trainer.jobs import Job, run_cloak
from ..trainer.preferences import user_folder
from ..ui.operator import BodyOperator, CloakOperator, push_undo
from .operators import take


@of_the_body
def heatmap_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why the detector cannot be asked which faces it looks at."""
    return refusal(require_upright, obj) or refusal(train_request, context.scene.cloak)


@of_the_body
def heat_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why no logo can be made of a heat map."""
    if obj.data.attributes.get(HEAT) is None:
        return f"'{obj.name}' has no heat map: press Heatmap first"
    return "Leave Edit Mode (Tab) to take faces from the heat map" if obj.mode == "EDIT" else ""


@of_the_body
def shown_heat_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why a heat map can be neither shown nor hidden."""
    if obj.data.attributes.get(HEAT) is None:
        return f"'{obj.name}' has no heat map: press Heatmap first"
    return "Leave Edit Mode (Tab) to see the heat map" if context.mode != "OBJECT" else ""


class CLOAK_OT_heatmap(CloakOperator, label="Heatmap", needs=heatmap_reason):
    """Colour the body by how much each face moves the chosen detector's score: a logo pays where it is bright"""

    def run(self, context: bpy.types.Context) -> str:
        obj, settings = active_body(context), context.scene.cloak
        if obj.mode == "EDIT":
            bpy.ops.object.mode_set(mode="OBJECT")
        folder = first_free(user_folder("heatmap"), "heat")
        write_scene(folder / "scene", export_bodies(context, obj, pose_choice(settings)))
        words = heatmap_words(train_request(settings), folder)
        uid, expected = obj.session_uid, topology(obj)
        show = lambda job: _show_heat(job, folder / "heat.npy", uid, expected)
        return "Measuring which faces move the detector" + run_cloak("Heatmap", words, folder, "heatmap", show, True)


def heatmap_words(request: TrainRequest, folder: Path) -> list[object]:
    """`cloak logo heatmap` of the first detector, from `scene` to `heat.npy` in a folder."""
    options = detector_options(request.detectors[:1]) + request.options("backgrounds", "angles", "device")
    return ["logo", "heatmap", "--scene", folder / "scene", *options, "--out", folder / "heat.npy"]


def _show_heat(job: Job, path: Path, uid: int, expected: str) -> str | None:
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


class CLOAK_OT_heatmap_toggle(BodyOperator, label="Toggle Heatmap", needs=shown_heat_reason):
    """Show the heat map, or give the body its own look, or its cloak, back; the heat stays for New from Heatmap"""

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        if colors.shows_heat(obj):
            colors.hide_heat(context, obj, is_dressed(obj))
            return f"'{obj.name}' shows its heat map no more"
        show_heat(context, obj, read(obj.data.attributes[HEAT].data, "value"))
        return f"'{obj.name}' shows its heat map"


class CLOAK_OT_logo_from_heat(BodyOperator, label="New from Heatmap", needs=heat_reason):
    """Make a logo of the faces that move the detector most for their size"""

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        heat = read(obj.data.attributes[HEAT].data, "value")
        ids = hottest_faces(heat, faces.face_areas(obj), context.scene.cloak.heat_share)
        return f"Logo '{take(obj, np.isin(np.arange(len(heat)), ids), 'Heat')}': {len(ids):,} faces"
