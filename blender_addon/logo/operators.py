# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 2, the logo."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..blender import faces
from ..blender.mesh_arrays import current_mesh, topology
from ..body.objects import active_body, logo_reason
from ..exchange.face_lists import write_face_list
from ..files.errors import InputError
from ..ui import props
from ..ui.operator import BodyOperator, CloakOperator


def selected_faces(obj: bpy.types.Object) -> np.ndarray:
    """Mask of the selected faces; `InputError` when there are none."""
    mask = faces.read_selection(obj)
    if not mask.any():
        raise InputError("No faces selected: select some in Edit Mode (hidden faces do not count)")
    return mask


def take(obj: bpy.types.Object, mask: np.ndarray, name: str, add: bool = False) -> str:
    """Make a logo of a mask's faces, or with `add` put them into the active one; returns the logo's name."""
    if add:
        name = faces.active_logo(obj)
        faces.add_faces(obj, name, mask)
    else:
        name = faces.new_logo(obj, name, mask)
    obj.cloak.logo = name
    return name


class LogoOperator(BodyOperator):
    """Base of operators that give the active logo other faces: `faces_from(obj, mask) -> mask`."""

    def faces_from(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        name = faces.active_logo(obj)
        with current_mesh(obj):
            mask = self.faces_from(obj, faces.read_faces(obj, name))
            faces.write_faces(obj, name, mask)
        return f"Logo '{name}': {int(mask.sum()):,} faces"


class CLOAK_OT_logo_new(BodyOperator, label="New from Selection"):
    """Make a logo of the selected faces"""

    name: props.text("Name", "Name of the new logo", "Logo")

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        mask = selected_faces(obj)
        return f"Logo '{take(obj, mask, self.name)}': {int(mask.sum()):,} faces"


class CLOAK_OT_logo_assign(LogoOperator, label="Assign", needs=logo_reason):
    """Add the selected faces to the active logo"""

    def faces_from(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        return mask | selected_faces(obj)


class CLOAK_OT_logo_unassign(LogoOperator, label="Remove", needs=logo_reason):
    """Take the selected faces out of the active logo"""

    def faces_from(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        return mask & ~faces.read_selection(obj)


class CLOAK_OT_logo_select(BodyOperator, label="Select", needs=logo_reason):
    """Select the faces of the active logo"""

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        name = faces.active_logo(obj)
        with current_mesh(obj):
            mask = faces.require_logo(obj, name)
            hidden = faces.select_faces(obj, mask)
        note = f"; {hidden:,} are hidden and stay unselected: reveal them with Alt H" if hidden else ""
        return f"Selected {int(mask.sum()):,} faces{note}"


class CLOAK_OT_logo_remove(BodyOperator, label="Delete Logo", needs=logo_reason):
    """Delete the active logo; the faces themselves stay"""

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        name = faces.active_logo(obj)
        faces.remove_logo(obj, name)
        obj.cloak.logo = next(iter(faces.logo_names(obj.data)), "")
        return f"Deleted logo '{name}'"


class CLOAK_OT_logo_mirror(BodyOperator, label="Mirror", needs=logo_reason):
    """Mirror the active logo across the object's X axis"""

    extend: props.switch("Extend", "Keep the faces of this side as well", True)

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        self.show(0.3)
        name = faces.active_logo(obj)
        with current_mesh(obj):
            mask = faces.require_logo(obj, name)
            mirrored, lost = faces.mirror(obj, mask)
            if not mirrored.any():
                raise InputError(
                    f"No face lies opposite logo '{name}' across X: the mesh is not symmetric, or its origin is off"
                )
            faces.write_faces(obj, name, mirrored | mask if self.extend else mirrored)
        note = f"; {lost:,} have no opposite" if lost else ""
        return f"Logo '{name}': {int(mirrored.sum()):,} faces mirrored{note}"


class CLOAK_OT_logo_grow(LogoOperator, label="Grow", needs=logo_reason):
    """Extend the active logo by the faces around it"""

    def faces_from(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        return faces.grow(obj, mask)


class CLOAK_OT_logo_shrink(LogoOperator, label="Shrink", needs=logo_reason):
    """Take the outermost faces off the active logo"""

    def faces_from(self, obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
        smaller = faces.shrink(obj, mask)
        if not smaller.any():
            raise InputError("The logo is too small to shrink: nothing would be left")
        return smaller


# --- files -----------------------------------------------------------------------------------------------------------


class CLOAK_OT_logo_export(CloakOperator, ExportHelper, label="Export Face List", needs=logo_reason):
    """Write the active logo as a face list (.npy) with its sidecar (.json), for the command line"""

    filename_ext = ".npy"
    filter_glob: StringProperty(default="*.npy", options={"HIDDEN"})

    def run(self, context: bpy.types.Context) -> str:
        obj = active_body(context)
        name = faces.active_logo(obj)
        with current_mesh(obj):
            ids = np.flatnonzero(faces.require_logo(obj, name))
            write_face_list(self.filepath, ids, topology(obj))
        return f"Wrote {self.filepath}: {len(ids):,} faces of '{obj.name}'"


class CLOAK_OT_logo_import(BodyOperator, ImportHelper, label="Import Face List"):
    """Make a logo from a face list (.npy) that was made for this mesh"""

    filename_ext = ".npy"
    filter_glob: StringProperty(default="*.npy;*.idx", options={"HIDDEN"})

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        self.show(0.3)
        obj.cloak.logo = faces.import_face_list(obj, Path(self.filepath))
        return f"Logo '{obj.cloak.logo}': {int(faces.read_faces(obj, obj.cloak.logo).sum()):,} faces"
