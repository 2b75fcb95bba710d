# SPDX-License-Identifier: GPL-3.0-or-later
"""Painting a logo: the brush, with the mouse or from a list of places, and its tool in the toolbars."""

import bpy
import numpy as np
from bpy.props import CollectionProperty
from bpy_extras.view3d_utils import region_2d_to_location_3d
from gpu_extras.presets import draw_circle_2d
from mathutils import Vector

from ..blender import faces
from ..blender.evaluated import Surface, read_surface
from ..files.errors import InputError
from ..ui import props
from ..ui.operator import BodyOperator
from .operators import take
from .overlay import ADDED, MOVES, PAINT, TAKEN, Preview

SPACING = 0.4  # of the radius: from one dab to the next
RADIUS = "scene.cloak.brush_radius"


class CLOAK_OT_logo_paint(BodyOperator, label="Paint Logo"):
    """Paint faces into the active logo, or out of it with Ctrl. The brush takes faces that look to the side it \
touches; with X-Ray on, also those behind, all through the body"""

    action: props.choice(
        "Action",
        "What the brush does to the logo",
        ("ADD", "Add", "Add faces to the logo"),
        ("REMOVE", "Remove", "Take faces out of the logo"),
    )
    mirror: props.switch("Mirror", "Paint on the other side of the object's X = 0 plane as well")
    stroke: CollectionProperty(
        name="Stroke",
        description="Dabs of the brush: places on the body and radii, in world space",
        type=bpy.types.OperatorStrokeElement,
        options={"SKIP_SAVE"},
    )

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        surface = read_surface(context, obj)
        painted = [self._dab(obj, surface, Vector(dab.location), dab.size) for dab in self.stroke]
        return self._write(obj, surface, np.unique(np.concatenate([np.zeros(0, np.int64), *painted])))

    def _dab(self, obj: bpy.types.Object, surface: Surface, place: Vector, radius: float) -> np.ndarray:
        """Find the faces [n] under the brush at a point, and with `mirror` the opposite ones."""
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
        if removes:
            obj.cloak.logo = name = faces.active_logo(obj)
            faces.write_faces(obj, name, ~mask, where=mask)
        else:
            name = take(obj, mask, "Logo", add=bool(faces.logo_names(obj.data)))
        return f"Logo '{name}': {int(mask.sum()):,} faces painted {'out' if removes else 'in'}"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.attempt(self._begin, context, event)

    def _begin(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if context.region_data is None or context.region.type != "WINDOW":
            raise InputError("Paint in a 3D viewport")
        self._obj = context.object
        self._surface = read_surface(context, self._obj)
        if self.action == "REMOVE":
            faces.active_logo(self._obj)
        settings = context.scene.cloak
        self.mirror, self._pixels = settings.brush_mirror, settings.brush_radius
        self.stroke.clear()
        self._painted = np.zeros(len(self._surface.centers), bool)
        self._last = Vector((event.mouse_region_x, event.mouse_region_y))
        self._preview = Preview(self._surface, TAKEN if self.action == "REMOVE" else ADDED)
        self._preview.register()
        self._touch(context, self._last)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in MOVES:  # dabs all along the way, so that a quick mouse leaves no gaps
            way = Vector((event.mouse_region_x, event.mouse_region_y)) - self._last
            spacing = max(1.0, SPACING * self._pixels)
            for _ in range(int(way.length / spacing)):
                self._last = self._last + way.normalized() * spacing
                self._touch(context, self._last)
        ends = event.type == "LEFTMOUSE" and event.value == "RELEASE"
        if not ends and event.type not in {"ESC", "RIGHTMOUSE"}:
            return {"RUNNING_MODAL"}
        self._preview.unregister()
        context.area.tag_redraw()
        if not ends or not self._painted.any():
            return {"CANCELLED"}
        return self.attempt(self._write, self._obj, self._surface, np.flatnonzero(self._painted))

    def _touch(self, context: bpy.types.Context, mouse: Vector) -> None:
        """One dab, where the mouse points; with X-Ray, one at each place that its ray meets."""
        view = (context.region, context.region_data)
        hits, _ = self._surface.under(*view, mouse)
        shading = context.space_data.shading
        through = shading.show_xray_wireframe if shading.type == "WIREFRAME" else shading.show_xray
        for place in map(Vector, hits if through else hits[:1]):
            beside = region_2d_to_location_3d(*view, mouse + Vector((self._pixels, 0)), place)
            dab = self.stroke.add()
            dab.location, dab.size, dab.mouse = place, (beside - place).length, mouse
            painted = self._dab(self._obj, self._surface, place, dab.size)
            self._preview.show(painted[~self._painted[painted]], alone=False)
            self._painted[painted] = True
        context.area.tag_redraw()


def _key(key: str, **modifiers: bool) -> dict[str, object]:
    return {"type": key, "value": "PRESS"} | modifiers


class PaintTool:
    """Paint faces into the active logo"""

    bl_space_type = "VIEW_3D"
    bl_idname = PAINT
    bl_label = "Paint Logo"
    bl_description = "Paint faces into Cloak's active logo; Ctrl takes them out, F and [ ] change the brush's radius"
    bl_icon = "ops.generic.select_paint"
    bl_cursor = "PAINT_CROSS"
    bl_keymap = (
        ("cloak.logo_paint", _key("LEFTMOUSE"), {"properties": [("action", "ADD")]}),
        ("cloak.logo_paint", _key("LEFTMOUSE", ctrl=True), {"properties": [("action", "REMOVE")]}),
        ("wm.radial_control", _key("F"), {"properties": [("data_path_primary", RADIUS)]}),
        ("wm.context_scale_int", _key("LEFT_BRACKET"), {"properties": [("data_path", RADIUS), ("value", 0.9)]}),
        ("wm.context_scale_int", _key("RIGHT_BRACKET"), {"properties": [("data_path", RADIUS), ("value", 1.1)]}),
    )

    @staticmethod
    def draw_settings(context: bpy.types.Context, layout: bpy.types.UILayout, tool: object) -> None:
        settings = context.scene.cloak
        layout.prop(settings, "brush_radius")
        layout.prop(settings, "brush_mirror", toggle=True)

    @staticmethod
    def draw_cursor(context: bpy.types.Context, tool: object, xy: tuple[int, int]) -> None:
        draw_circle_2d(xy, (1, 1, 1, 1), context.scene.cloak.brush_radius, segments=48)


TOOLS = [
    type(f"PaintIn{mode}", (PaintTool, bpy.types.WorkSpaceTool), {"bl_context_mode": mode})
    for mode in ("EDIT_MESH", "OBJECT")
]


def register() -> None:
    for tool in TOOLS:
        bpy.utils.register_tool(tool, separator=True)


def unregister() -> None:
    for tool in reversed(TOOLS):
        bpy.utils.unregister_tool(tool)
