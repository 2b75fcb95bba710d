# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 1, the body."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np

from .. import steps
from ..body import add_from_scene, subdivide, topology
from ..command_lines import SAMPLE, sample_command
from ..exchange.scenes import read_scene
from ..files.errors import InputError
from ..jobs import Job, launch, require_idle
from ..mesh_arrays import to_world
from ..modifiers import applied_copy
from ..preferences import chosen_python, user_folder
from ..properties import settings_of
from .base import BodyOperator, CloakOperator, push_undo
from .cursor import progress_cursor

GAP = 0.3
"""Between a new body and what stands beside it, in Blender's units."""


class CLOAK_OT_subdivide(BodyOperator):
    """Split every face of the body in place (Simple, one level), so that the cloak has more and smaller faces. Shape \
keys, weights, materials, UVs and logos are kept"""

    bl_label = "Subdivide Body"

    triangulate: bpy.props.BoolProperty(
        name="Triangulate", description="Also split every face into triangles", default=True
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.triangulate = settings_of(context).triangulate
        return self.execute(context)

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        with progress_cursor(context) as show:
            before, after = subdivide(obj, self.triangulate, show)
        return f"'{obj.name}': {before:,} faces became {after:,}"


class CLOAK_OT_apply_copy(BodyOperator):
    """Make a copy of the body with the modifiers applied that make new faces, and hide the original. Deforming \
modifiers stay; shape keys end in their present mix"""

    bl_label = "Apply a Copy"

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        if obj.mode == "EDIT":
            raise InputError("Leave Edit Mode (Tab) to apply modifiers")
        copy = applied_copy(context, obj)
        return f"'{copy.name}': {len(copy.data.polygons):,} faces; '{obj.name}' is hidden"


class CLOAK_OT_add_sample_body(CloakOperator):
    """Add Cloak's sample body: people of varied shape as shape keys, one per frame, with named regions as logos"""

    bl_label = "Add Sample Body"
    needs = staticmethod(steps.idle_reason)

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        folder = user_folder("sample")
        scene = folder / "scene"
        shutil.rmtree(scene, ignore_errors=True)
        command = sample_command(chosen_python(), scene)
        launch(Job("Sample body", [command], folder, "sample", lambda job: _add(job, scene)))
        return "Fetching the sample body from the trainer"


def _add(job: Job, scene: Path) -> str | None:
    if job.state != "done":
        return None
    bodies = read_scene(scene)
    obj = add_from_scene(bpy.context, bodies)
    obj.name = obj.data.name = "Sample Body"
    obj.cloak.made_from = f"{SAMPLE}|{topology(obj)}"
    stand_clear(bpy.context, obj)
    look_at_selected()
    settings = settings_of(bpy.context)
    settings.pose_source, settings.frame_step = "RANGE", 1
    settings.frame_start, settings.frame_end = bpy.context.scene.frame_start, bpy.context.scene.frame_end
    if "chest" in bodies.regions:
        obj.cloak.logo = "chest"
    push_undo("Add Sample Body")
    return f"Added '{obj.name}': {len(obj.data.polygons):,} faces"


def stand_clear(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Move a new body to the right until it stands in no other visible mesh, such as the cube of a new file."""
    context.view_layer.update()
    low, high = _bounds(obj)
    meshes = [o for o in context.visible_objects if o.type == "MESH" and o != obj and len(o.data.vertices)]
    start = low[0]
    for other_low, other_high in sorted(map(_bounds, meshes), key=lambda box: box[0][0]):
        if (low < other_high).all() and (other_low < high).all():
            step = other_high[0] + GAP - low[0]
            low[0], high[0] = low[0] + step, high[0] + step
    obj.location.x += low[0] - start


def _bounds(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner [3] of the object's box in the world."""
    corners = to_world(np.array(obj.bound_box, np.float64), np.array(obj.matrix_world))
    return corners.min(0), corners.max(0)


def look_at_selected() -> None:
    """Let every 3D viewport frame what is selected."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            region = next((r for r in area.regions if r.type == "WINDOW"), None)
            if area.type == "VIEW_3D" and region is not None and not bpy.app.background:
                with bpy.context.temp_override(window=window, area=area, region=region):
                    bpy.ops.view3d.view_selected()


CLASSES = (CLOAK_OT_subdivide, CLOAK_OT_apply_copy, CLOAK_OT_add_sample_body)
