# SPDX-License-Identifier: GPL-3.0-or-later
"""Painting a logo onto the body as it is seen: with a brush, or with a stamp; by the mouse, or from given places."""

import math

import bpy
import numpy as np
from bpy.props import CollectionProperty, FloatVectorProperty
from bpy_extras.view3d_utils import region_2d_to_location_3d
from gpu_extras.presets import draw_circle_2d
from mathutils import Vector

from ..blender import faces
from ..blender.evaluated import joined, read_surface
from ..blender.mesh_arrays import triangle_areas
from ..body.garments import worn_by
from ..body.objects import active_body, body_reason, require_upright, upright_reason
from ..files.errors import InputError
from ..ui import props
from ..ui.bases import WITH_UNDO, CloakOperator, operator
from ..ui.window import main_region, progress_cursor, show_progress
from .operators import ADD, take
from .overlay import ADDED, MOVES, PAINT, TAKEN, Preview
from .stamp import Placed, Projection, chosen_stamp, front_projection, laid

RUNNING = {"RUNNING_MODAL"}
SPACING = 0.4  # of the radius: from one dab to the next
RADIUS = "scene.cloak.brush_radius"
PAPER_SHARE = 0.044  # of the body's area: 2,426 (letter G) and 2,427 (smiley) of the paper's 55,152 faces
SIZES = {
    **dict.fromkeys(("WHEELUPMOUSE", "NUMPAD_PLUS", "EQUAL"), 1.08),
    **dict.fromkeys(("WHEELDOWNMOUSE", "NUMPAD_MINUS", "MINUS"), 1 / 1.08),
}
"""Factor of the size for a click of the mouse wheel, or a key."""
HELP = "Move: place   Wheel, + -: size   R: rotate with the mouse   Click, Enter: stamp   Right click, Esc: cancel"


class MouseOperator(CloakOperator):
    """Base of operators that follow the mouse over a viewport, and show what they will take until they end.

    `begin(context, obj)` reads the body's `surface` and returns the colour of the preview on it; `follow(mouse)` gets
    the mouse's place, [2] pixels of the viewport's main region, `key(event)` what is pressed; `write` makes a logo of
    what the preview showed. `change(context, obj)` does the same from given places, without a mouse.
    """

    bl_options = WITH_UNDO

    def run(self, context: bpy.types.Context) -> str:
        with progress_cursor():
            return self.change(context, active_body(context))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.attempt(self._invoke, context, event)

    def _invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if context.area is None or context.area.type != "VIEW_3D":
            raise InputError("No 3D viewport to paint in")
        self._area, self._region = context.area, main_region(context.area)
        color = self.begin(context, context.object)
        self.preview = Preview(self.surface, color)
        self.preview.register()
        self.follow(self.mouse(event))
        context.window_manager.modal_handler_add(self)
        return RUNNING

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in MOVES:
            self.follow(self.mouse(event))
            return RUNNING
        return self.end(False) if event.type in {"ESC", "RIGHTMOUSE"} else self.key(event)

    def mouse(self, event: bpy.types.Event) -> Vector:
        """Where the mouse is in the viewport, whatever region it was pressed in."""
        return Vector((event.mouse_x - self._region.x, event.mouse_y - self._region.y))

    @property
    def view(self) -> tuple[bpy.types.Region, bpy.types.RegionView3D]:
        return self._region, self._area.spaces.active.region_3d

    def redraw(self) -> None:
        self._area.tag_redraw()

    def end(self, write: bool, *arguments: object) -> set[str]:
        """Take the preview away, and `write(*arguments)` what it showed, unless the user gave up."""
        self.preview.unregister()
        self._area.header_text_set(None)
        self.redraw()
        return self.attempt(self.write, *arguments) if write else {"CANCELLED"}


class CLOAK_OT_logo_paint(MouseOperator, label="Paint Logo", needs=[body_reason]):
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
        self._obj, self.surface = obj, read_surface(context, obj)
        painted = [self._dab(Vector(dab.location), dab.size) for dab in self.stroke]
        return self.write(np.unique(np.concatenate([np.zeros(0, np.int64), *painted])))

    def _dab(self, place: Vector, radius: float) -> np.ndarray:
        """Find the faces [n] under the brush at a point, and with `mirror` the opposite ones."""
        dabs = [self.surface.around(np.array(place), radius)]
        if self.mirror:
            matrix = self._obj.matrix_world
            opposite = matrix @ (Vector((-1, 1, 1)) * (matrix.inverted_safe() @ place))
            dabs.append(self.surface.around(np.array(opposite), radius))
        return np.concatenate(dabs)

    def write(self, painted: np.ndarray) -> str:
        """Put these evaluated faces [n] into the logo, or take them out; returns what to say."""
        obj, mask = self._obj, self.surface.own_mask(painted)
        if not mask.any():
            raise InputError("The brush touched no face of the body")
        removes = self.action == "REMOVE"
        if removes:
            obj.cloak.logo = name = faces.active_logo(obj)
            faces.write_faces(obj, name, ~mask, where=mask)
        else:
            name = take(obj, mask, "Logo", add=bool(faces.logo_names(obj.data)))
        return f"Logo '{name}': {int(mask.sum()):,} faces painted {'out' if removes else 'in'}"

    def begin(self, context: bpy.types.Context, obj: bpy.types.Object) -> tuple[float, ...]:
        self._obj, self.surface = obj, read_surface(context, obj)
        if self.action == "REMOVE":
            faces.active_logo(obj)
        settings = context.scene.cloak
        shading = context.space_data.shading
        self.mirror, self._pixels = settings.brush_mirror, settings.brush_radius
        self._through = shading.show_xray_wireframe if shading.type == "WIREFRAME" else shading.show_xray
        self.stroke.clear()
        self._painted = np.zeros(len(self.surface.centers), bool)
        self._last: Vector | None = None
        return TAKEN if self.action == "REMOVE" else ADDED

    def key(self, event: bpy.types.Event) -> set[str]:
        if event.type == "LEFTMOUSE" and event.value == "RELEASE":
            return self.end(self._painted.any(), np.flatnonzero(self._painted))
        return RUNNING

    def follow(self, mouse: Vector) -> None:
        """Dabs all along the way from the last one, so that a quick mouse leaves no gaps."""
        if self._last is None:
            self._last = mouse
            self._touch(mouse)
        way, spacing = mouse - self._last, max(1.0, SPACING * self._pixels)
        for _ in range(int(way.length / spacing)):
            self._last = self._last + way.normalized() * spacing
            self._touch(self._last)

    def _touch(self, mouse: Vector) -> None:
        """One dab, where the mouse points; with X-Ray, one at each place that its ray meets."""
        hits, _ = self.surface.under(*self.view, mouse)
        for place in map(Vector, hits if self._through else hits[:1]):
            beside = region_2d_to_location_3d(*self.view, mouse + Vector((self._pixels, 0)), place)
            dab = self.stroke.add()
            dab.location, dab.size, dab.mouse = place, (beside - place).length, mouse
            painted = self._dab(place, dab.size)
            self.preview.show(painted[~self._painted[painted]], alone=False)
            self._painted[painted] = True
        self.redraw()


class BodyStamp(Placed):
    """The stamp that is set, laid onto the body and what it wears: clothing takes the faces that it covers."""

    def __init__(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        require_upright(obj)
        ink, self._name = chosen_stamp(context.scene.cloak)
        self._obj, self._worn = obj, worn_by(obj)
        super().__init__(joined([read_surface(context, one) for one in (obj, *self._worn)]), ink)
        show_progress(0.6)  # a body with subdivision takes seconds

    def make_logo(self, projection: Projection, add: bool) -> str:
        """Make a logo of the faces that it covers, or with `add` put them into the active one; returns what to say."""
        mask = self.own_mask(projection)
        show_progress(0.9)
        name = take(self._obj, mask, self._name, add, self._worn)
        return f"Logo '{name}': {int(mask.sum()):,} faces under the stamp"


@operator("Stamp", told_by="add", add=ADD)
def logo_stamp(context: bpy.types.Context, obj: bpy.types.Object, add: bool) -> str:
    """Project the stamp onto the body's front and make a logo of the faces it covers"""
    settings, placed = context.scene.cloak, BodyStamp(context, obj)
    place = (settings.stamp_size, settings.stamp_center, settings.stamp_offset)
    return placed.make_logo(front_projection(obj, *place, placed.aspect), add)


class CLOAK_OT_stamp_drag(MouseOperator, label="Place Stamp", needs=[upright_reason], told_by="kind"):
    """Drag the stamp over the body, see what it takes, click to stamp. The mouse wheel resizes, R rotates"""

    add: ADD
    kind: props.choice(
        "Stamp",
        "What is stamped",
        ("SETTINGS", "As Set", "The text, picture or smiley that is chosen under Stamp"),
        ("LETTER", "Paper's Letter", "The letter G with the paper's share of the body"),
        ("SMILEY", "Paper's Smiley", "The smiley with the paper's share of the body"),
    )
    place: FloatVectorProperty(name="Place", description="Middle of the stamp on the body", subtype="TRANSLATION")
    direction: FloatVectorProperty(
        name="Direction", description="Into the body, from where it is stamped", subtype="DIRECTION", default=(0, 1, 0)
    )
    height: props.number("Height", "Height of the stamp", 0.3, min=1e-6, subtype="DISTANCE")
    angle: props.number("Angle", "Turns the stamp against the clock", subtype="ANGLE")

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        self._read(context, obj)
        return self.write()

    def _read(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        settings = context.scene.cloak
        if self.kind == "LETTER":
            settings.stamp_kind, settings.stamp_text = "TEXT", "G"
        elif self.kind == "SMILEY":
            settings.stamp_kind = "SMILEY"
        self._placed = BodyStamp(context, obj)
        self.surface = self._placed.surface

    def _projection(self) -> Projection:
        place, direction = np.array(self.place), np.array(self.direction)
        return laid(place, direction, self.height, self._placed.aspect, self.angle)

    def write(self) -> str:
        return self._placed.make_logo(self._projection(), self.add)

    def begin(self, context: bpy.types.Context, obj: bpy.types.Object) -> tuple[float, ...]:
        self._read(context, obj)
        if self.kind != "SETTINGS":
            area = float(triangle_areas(self.surface.points, self.surface.corners).sum())
            self.height = math.sqrt(PAPER_SHARE * area / (self._placed.ink.mean() * self._placed.aspect))
        else:
            self.height = context.scene.cloak.stamp_size * float(np.ptp(self.surface.points[:, 2]))
        self.angle = 0.0
        self._turning: tuple[float, float] | None = None  # where the mouse was, and the angle, when R was pressed
        context.area.header_text_set(HELP)
        return ADDED

    def key(self, event: bpy.types.Event) -> set[str]:
        pressed = event.value == "PRESS"
        if event.type in SIZES and pressed:
            self.height *= SIZES[event.type]
            self._show()
        elif event.type == "R" and pressed:
            self._turning = None if self._turning else (self.mouse(event).x, self.angle)
        elif event.type in {"LEFTMOUSE", "RET", "NUMPAD_ENTER"} and pressed:
            return self.end(True)
        elif event.type == "MIDDLEMOUSE" or event.type.startswith(("NDOF", "TRACKPAD")):
            return {"PASS_THROUGH"}  # looking around
        return RUNNING

    def follow(self, mouse: Vector) -> None:
        """The mouse turns the stamp, or takes it along over the body."""
        if self._turning:
            self.angle = self._turning[1] - (mouse.x - self._turning[0]) * math.radians(0.5)
        else:
            hits, direction = self.surface.under(*self.view, mouse)
            if len(hits):
                self.place, self.direction = Vector(hits[0]), direction
        self._show()

    def _show(self) -> None:
        self.preview.show(self._placed.faces(self._projection()), alone=True)
        self.redraw()


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
