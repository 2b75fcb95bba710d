# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush that paints a logo's faces: one stroke, with the mouse or from a list of places."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.props import BoolProperty, CollectionProperty, EnumProperty
from bpy_extras.view3d_utils import region_2d_to_location_3d, region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Vector

from ..blender import faces
from ..blender.mesh_arrays import current_mesh
from ..blender.surface import Surface, read_surface
from ..files.errors import InputError
from ..properties import settings_of
from ..ui.operator import BodyOperator
from .operators import active_logo
from .preview import ADDED, TAKEN, Preview

SPACING = 0.4
"""Of the radius: from one dab to the next."""
MOVES = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}


class CLOAK_OT_logo_paint(BodyOperator):
    """Paint faces into the active logo, or out of it with Ctrl. The brush takes faces that look to the side it \
touches; with X-Ray on, also those behind, all through the body"""

    bl_label = "Paint Logo"

    action: EnumProperty(
        name="Action",
        description="What the brush does to the logo",
        items=[("ADD", "Add", "Add faces to the logo"), ("REMOVE", "Remove", "Take faces out of the logo")],
    )
    mirror: BoolProperty(name="Mirror", description="Paint on the other side of the object's X = 0 plane as well")
    stroke: CollectionProperty(
        name="Stroke",
        description="Dabs of the brush: places on the body and radii, in world space",
        type=bpy.types.OperatorStrokeElement,
        options={"SKIP_SAVE"},
    )

    # --- from a list of places ---

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        self.show(0.3)
        surface = read_surface(context, obj)
        painted = [self._dab(obj, surface, Vector(dab.location), dab.size) for dab in self.stroke]
        return self._write(obj, surface, np.unique(np.concatenate([np.zeros(0, np.int64), *painted])))

    def _dab(self, obj: bpy.types.Object, surface: Surface, place: Vector, radius: float) -> np.ndarray:
        """The faces [n] under the brush at a place on the body, and those opposite."""
        dabs = [surface.around(np.array(place), radius)]
        if self.mirror:
            opposite = obj.matrix_world @ (Vector((-1, 1, 1)) * (obj.matrix_world.inverted_safe() @ place))
            dabs.append(surface.around(np.array(opposite), radius))
        return np.concatenate(dabs)

    def _write(self, obj: bpy.types.Object, surface: Surface, painted: np.ndarray) -> str:
        mask = surface.own_mask(painted)
        if not mask.any():
            raise InputError("The brush touched no face of the body")
        removes = self.action == "REMOVE"
        with current_mesh(obj):
            if not removes and not faces.logo_names(obj.data):
                name = faces.new_logo(obj, "Logo", mask)
            else:
                name = active_logo(obj)
                (faces.remove_faces if removes else faces.add_faces)(obj, name, mask)
        obj.cloak.logo = name
        return f"Logo '{name}': {int(mask.sum()):,} faces painted {'out' if removes else 'in'}"

    # --- with the mouse ---

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.attempt(self._begin, context, event)

    def _begin(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if context.region_data is None or context.region.type != "WINDOW":
            raise InputError("Paint in a 3D viewport")
        self._obj = context.object
        self._surface = read_surface(context, self._obj)
        if self.action == "REMOVE":
            active_logo(self._obj)
        settings = settings_of(context)
        self.mirror, self._pixels = settings.brush_mirror, settings.brush_radius
        self.stroke.clear()
        self._painted = np.zeros(len(self._surface.centers), bool)
        self._last = Vector((event.mouse_region_x, event.mouse_region_y))
        self._preview = Preview(self._surface, TAKEN if self.action == "REMOVE" else ADDED)
        self._preview.begin()
        self._touch(context, self._last)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in MOVES:
            self._move(context, Vector((event.mouse_region_x, event.mouse_region_y)))
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            return self._finish(context)
        elif event.type in {"ESC", "RIGHTMOUSE"}:
            self._preview.end()
            context.area.tag_redraw()
            return {"CANCELLED"}
        return {"RUNNING_MODAL"}

    def _finish(self, context: bpy.types.Context) -> set[str]:
        self._preview.end()
        context.area.tag_redraw()
        if not self._painted.any():
            return {"CANCELLED"}
        return self.attempt(self._write, self._obj, self._surface, np.flatnonzero(self._painted))

    def _move(self, context: bpy.types.Context, mouse: Vector) -> None:
        """Dabs all along the way from the last one, so that a quick mouse leaves no gaps."""
        way, spacing = mouse - self._last, max(1.0, SPACING * self._pixels)
        for _ in range(int(way.length / spacing)):
            self._last = self._last + way.normalized() * spacing
            self._touch(context, self._last)

    def _touch(self, context: bpy.types.Context, mouse: Vector) -> None:
        """One dab, where the mouse points; with X-Ray, one at each place that its ray meets."""
        view = (context.region, context.region_data)
        origin, direction = region_2d_to_origin_3d(*view, mouse), region_2d_to_vector_3d(*view, mouse)
        hits = self._surface.hits(np.array(origin), np.array(direction))
        shading = context.space_data.shading
        through = shading.show_xray_wireframe if shading.type == "WIREFRAME" else shading.show_xray
        for place in map(Vector, hits if through else hits[:1]):
            beside = region_2d_to_location_3d(*view, mouse + Vector((self._pixels, 0)), place)
            dab = self.stroke.add()
            dab.location, dab.size, dab.mouse = place, (beside - place).length, mouse
            painted = self._dab(self._obj, self._surface, place, dab.size)
            self._preview.add(painted[~self._painted[painted]])
            self._painted[painted] = True
        context.area.tag_redraw()
