# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 2, the logo."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from .. import colors, faces, stamp
from ..body import active_body, require_upright, topology
from ..exchange.face_lists import write_face_list
from ..exchange.scenes import write_scene
from ..files.errors import InputError
from ..files.reading import read_npy
from ..preferences import trainer_python, user_folder
from ..properties import pose_choice, settings_of, train_request
from ..scene_export import export_bodies
from ..trainer import heatmap_command
from ..training_job import Job, launch, require_idle
from .base import WITH_UNDO, CloakOperator, push_undo

HEAT = "cloak_heat"
"""Float face attribute: the last heat map."""


def active_logo(obj: bpy.types.Object) -> str:
    """Name of the logo that is active in the list; `InputError` when the mesh has none."""
    names = faces.logo_names(obj.data)
    if not names:
        raise InputError(f"'{obj.name}' has no logo: select faces in Edit Mode and press New from Selection")
    return obj.cloak.logo if obj.cloak.logo in names else names[0]


def _hidden_note(count: int) -> str:
    return f"; {count:,} are hidden and stay unselected: reveal them with Alt H" if count else ""


class LogoOperator(CloakOperator):
    """Base of operators that change the active logo by `change(obj, mask) -> mask`."""

    bl_options = WITH_UNDO

    def change(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def run(self, context: bpy.types.Context) -> str:
        obj = active_body(context)
        name = active_logo(obj)
        mask = self.change(obj, faces.read_faces(obj, name))
        faces.write_faces(obj, name, mask)
        return f"Logo '{name}': {int(mask.sum()):,} faces"


class CLOAK_OT_logo_new(CloakOperator):
    """Make a logo of the selected faces"""

    bl_idname = "cloak.logo_new"
    bl_label = "New from Selection"
    bl_options = WITH_UNDO

    name: StringProperty(name="Name", description="Name of the new logo", default="Logo")

    def run(self, context: bpy.types.Context) -> str:
        obj = active_body(context)
        mask = faces.read_selection(obj)
        if not mask.any():
            raise InputError("No faces selected: select some in Edit Mode (hidden faces do not count)")
        obj.cloak.logo = faces.new_logo(obj, self.name, mask)
        return f"Logo '{obj.cloak.logo}': {int(mask.sum()):,} faces"


class CLOAK_OT_logo_assign(LogoOperator):
    """Add the selected faces to the active logo"""

    bl_idname = "cloak.logo_assign"
    bl_label = "Assign"

    def change(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        selected = faces.read_selection(obj)
        if not selected.any():
            raise InputError("No faces selected: select some in Edit Mode (hidden faces do not count)")
        return mask | selected


class CLOAK_OT_logo_unassign(LogoOperator):
    """Take the selected faces out of the active logo"""

    bl_idname = "cloak.logo_unassign"
    bl_label = "Remove"

    def change(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        return mask & ~faces.read_selection(obj)


class CLOAK_OT_logo_select(CloakOperator):
    """Select the faces of the active logo"""

    bl_idname = "cloak.logo_select"
    bl_label = "Select"
    bl_options = WITH_UNDO

    def run(self, context: bpy.types.Context) -> str:
        obj = active_body(context)
        name = active_logo(obj)
        mask = faces.require_logo(obj, name)
        return f"Selected {int(mask.sum()):,} faces" + _hidden_note(faces.select_faces(obj, mask))


class CLOAK_OT_logo_remove(CloakOperator):
    """Delete the active logo; the faces themselves stay"""

    bl_idname = "cloak.logo_remove"
    bl_label = "Delete Logo"
    bl_options = WITH_UNDO

    def run(self, context: bpy.types.Context) -> str:
        obj = active_body(context)
        name = active_logo(obj)
        faces.remove_logo(obj, name)
        obj.cloak.logo = next(iter(faces.logo_names(obj.data)), "")
        return f"Deleted logo '{name}'"


class CLOAK_OT_logo_mirror(CloakOperator):
    """Mirror the active logo across the object's X axis"""

    bl_idname = "cloak.logo_mirror"
    bl_label = "Mirror"
    bl_options = WITH_UNDO

    extend: BoolProperty(name="Extend", description="Keep the faces of this side as well", default=True)

    def run(self, context: bpy.types.Context) -> str:
        obj = active_body(context)
        name = active_logo(obj)
        mask = faces.require_logo(obj, name)
        mirrored, lost = faces.mirror(obj, mask)
        if not mirrored.any():
            raise InputError(
                f"No face lies opposite logo '{name}' across X: the mesh is not symmetric, or its origin is off"
            )
        faces.write_faces(obj, name, mirrored | mask if self.extend else mirrored)
        note = f"; {lost:,} have no opposite" if lost else ""
        return f"Logo '{name}': {int(mirrored.sum()):,} faces mirrored{note}"


class CLOAK_OT_logo_grow(LogoOperator):
    """Extend the active logo by the faces around it"""

    bl_idname = "cloak.logo_grow"
    bl_label = "Grow"

    def change(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        return faces.grow(obj, mask)


class CLOAK_OT_logo_shrink(LogoOperator):
    """Take the outermost faces off the active logo"""

    bl_idname = "cloak.logo_shrink"
    bl_label = "Shrink"

    def change(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        smaller = faces.shrink(obj, mask)
        if not smaller.any():
            raise InputError("The logo is too small to shrink: nothing would be left")
        return smaller


class CLOAK_OT_logo_stamp(CloakOperator):
    """Project the stamp onto the body and make a logo of the faces it covers"""

    bl_idname = "cloak.logo_stamp"
    bl_label = "Stamp"
    bl_options = WITH_UNDO

    target: EnumProperty(
        name="Target",
        description="Where the covered faces go",
        items=[("NEW", "New Logo", "Make a new logo"), ("ADD", "Active Logo", "Add to the active logo")],
    )

    def run(self, context: bpy.types.Context) -> str:
        obj, settings = active_body(context), settings_of(context)
        require_upright(obj)
        ink, name = _ink(settings)
        aspect = ink.shape[1] / ink.shape[0]
        if settings.stamp_from == "VIEW":
            projection = _from_view(context, settings.stamp_size, aspect)
        else:
            placed = (settings.stamp_size, settings.stamp_center, settings.stamp_offset)
            projection = stamp.front_projection(obj, *placed, aspect)
        mask = stamp.covered_faces(context, obj, ink, projection)
        if self.target == "ADD":
            name = active_logo(obj)
            faces.write_faces(obj, name, faces.read_faces(obj, name) | mask)
        else:
            name = faces.new_logo(obj, name, mask)
        obj.cloak.logo = name
        return f"Logo '{name}': {int(mask.sum()):,} faces under the stamp"


def _ink(settings: bpy.types.PropertyGroup) -> tuple[np.ndarray, str]:
    if settings.stamp_kind == "TEXT":
        return stamp.text_stamp(settings.stamp_text), settings.stamp_text.strip()
    if settings.stamp_kind == "IMAGE":
        return stamp.image_stamp(settings.stamp_image), Path(settings.stamp_image.name).stem
    return stamp.smiley_stamp(), "Smiley"


def _from_view(context: bpy.types.Context, size: float, aspect: float) -> stamp.Projection:
    area = context.area if context.area and context.area.type == "VIEW_3D" else None
    if area is None and context.window_manager.windows:
        screens = (window.screen for window in context.window_manager.windows)
        area = next((a for screen in screens for a in screen.areas if a.type == "VIEW_3D"), None)
    if area is None or area.spaces.active.region_3d is None:
        raise InputError("No 3D viewport to stamp from: choose From > Front")
    region = next(r for r in area.regions if r.type == "WINDOW")
    return stamp.view_projection(region, area.spaces.active.region_3d, size, aspect)


# --- files -----------------------------------------------------------------------------------------------------------


class CLOAK_OT_logo_export(CloakOperator, ExportHelper):
    """Write the active logo as a face list (.npy) with its sidecar (.json), for the command line"""

    bl_idname = "cloak.logo_export"
    bl_label = "Export Face List"

    filename_ext = ".npy"
    filter_glob: StringProperty(default="*.npy", options={"HIDDEN"})

    def run(self, context: bpy.types.Context) -> str:
        obj = active_body(context)
        name = active_logo(obj)
        ids = np.flatnonzero(faces.require_logo(obj, name))
        write_face_list(self.filepath, ids, topology(obj))
        return f"Wrote {self.filepath}: {len(ids):,} faces of '{obj.name}'"


class CLOAK_OT_logo_import(CloakOperator, ImportHelper):
    """Make a logo from a face list (.npy) that was made for this mesh"""

    bl_idname = "cloak.logo_import"
    bl_label = "Import Face List"
    bl_options = WITH_UNDO

    filename_ext = ".npy"
    filter_glob: StringProperty(default="*.npy;*.idx", options={"HIDDEN"})

    def run(self, context: bpy.types.Context) -> str:
        obj = active_body(context)
        obj.cloak.logo = faces.import_face_list(obj, Path(self.filepath))
        return f"Logo '{obj.cloak.logo}': {int(faces.read_faces(obj, obj.cloak.logo).sum()):,} faces"


# --- heat map --------------------------------------------------------------------------------------------------------


class CLOAK_OT_heatmap(CloakOperator):
    """Colour the body by how much each face moves the chosen detector's score: a logo pays where it is bright"""

    bl_idname = "cloak.heatmap"
    bl_label = "Heatmap"

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        obj, settings = active_body(context), settings_of(context)
        if obj.mode == "EDIT":
            bpy.ops.object.mode_set(mode="OBJECT")
        python, request = trainer_python(), train_request(settings)
        number = 1
        while (folder := user_folder("heatmap") / str(number)).exists():
            number += 1
        write_scene(folder / "scene", export_bodies(context, obj, pose_choice(settings)))
        heat, uid, expected = folder / "heat.npy", obj.session_uid, topology(obj)
        command = heatmap_command(python, request, folder / "scene", heat)
        launch(Job("Heatmap", [command], folder, "heatmap", lambda job: _show_heat(job, heat, uid, expected)))
        return "Measuring which faces move the detector"


def _show_heat(job: Job, path: Path, uid: int, expected: str) -> None:
    if job.state != "done":
        return
    obj = next((o for o in bpy.data.objects if o.session_uid == uid), None)
    try:
        if obj is None or topology(obj) != expected:
            raise InputError("The body changed while its heat map was made: press Heatmap again")
        show_heat(bpy.context, obj, read_npy(path))
        push_undo("Heatmap")
        shutil.rmtree(path.parent, ignore_errors=True)
        job.message = "Heatmap: bright faces move the detector most"
    except InputError as error:
        job.state, job.message = "failed", str(error)


def show_heat(context: bpy.types.Context, obj: bpy.types.Object, heat: np.ndarray) -> None:
    """Keep heat [F] on the mesh and show it in the viewports."""
    heat = np.asarray(heat, np.float32)[: len(obj.data.polygons)]
    if heat.shape != (len(obj.data.polygons),):
        raise InputError(f"The heat map has {len(heat)} values for {len(obj.data.polygons)} faces: press Heatmap again")
    attribute = obj.data.attributes.get(HEAT) or obj.data.attributes.new(HEAT, "FLOAT", "FACE")
    attribute.data.foreach_set("value", heat)
    colors.write_face_colors(obj, colors.HEATMAP, colors.heat_colors(heat))
    colors.show_attribute(context, obj, colors.HEATMAP)


class CLOAK_OT_logo_from_heat(CloakOperator):
    """Make a logo of the faces that move the detector most"""

    bl_idname = "cloak.logo_from_heat"
    bl_label = "New from Heatmap"
    bl_options = WITH_UNDO

    def run(self, context: bpy.types.Context) -> str:
        obj, settings = active_body(context), settings_of(context)
        attribute = obj.data.attributes.get(HEAT)
        if attribute is None:
            raise InputError(f"'{obj.name}' has no heat map: press Heatmap first")
        if obj.mode == "EDIT":
            raise InputError("Leave Edit Mode (Tab) to take faces from the heat map")
        heat = np.empty(len(obj.data.polygons), np.float32)
        attribute.data.foreach_get("value", heat)
        mask = faces.pick(heat, faces.face_areas(obj), settings.heat_share)
        obj.cloak.logo = faces.new_logo(obj, "Heat", mask)
        return f"Logo '{obj.cloak.logo}': {int(mask.sum()):,} faces"


CLASSES = (
    CLOAK_OT_logo_new,
    CLOAK_OT_logo_assign,
    CLOAK_OT_logo_unassign,
    CLOAK_OT_logo_select,
    CLOAK_OT_logo_remove,
    CLOAK_OT_logo_mirror,
    CLOAK_OT_logo_grow,
    CLOAK_OT_logo_shrink,
    CLOAK_OT_logo_stamp,
    CLOAK_OT_logo_export,
    CLOAK_OT_logo_import,
    CLOAK_OT_heatmap,
    CLOAK_OT_logo_from_heat,
)
