# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 1, the body."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy

from .. import steps
from ..body import add_from_scene, subdivide
from ..command_lines import sample_command
from ..exchange.scenes import read_scene
from ..files.errors import InputError
from ..jobs import Job, launch, require_idle
from ..modifiers import applied_copy
from ..preferences import chosen_python, user_folder
from ..properties import settings_of
from .base import BodyOperator, CloakOperator, push_undo
from .cursor import progress_cursor


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
    settings = settings_of(bpy.context)
    settings.pose_source, settings.frame_step = "RANGE", 1
    settings.frame_start, settings.frame_end = bpy.context.scene.frame_start, bpy.context.scene.frame_end
    if "chest" in bodies.regions:
        obj.cloak.logo = "chest"
    push_undo("Add Sample Body")
    return f"Added '{obj.name}': {len(obj.data.polygons):,} faces"


CLASSES = (CLOAK_OT_subdivide, CLOAK_OT_apply_copy, CLOAK_OT_add_sample_body)
