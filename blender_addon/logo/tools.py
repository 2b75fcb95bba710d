# SPDX-License-Identifier: GPL-3.0-or-later
"""The tool "Paint Logo" in the toolbar of the 3D viewport, in Edit Mode and in Object Mode."""

from __future__ import annotations

import bpy

from ..properties import settings_of

RADIUS = "scene.cloak.brush_radius"
PAINT = "cloak.paint_logo"


def _key(key: str, **modifiers: bool) -> dict[str, object]:
    return {"type": key, "value": "PRESS"} | modifiers


class _PaintTool:
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
        settings = settings_of(context)
        layout.prop(settings, "brush_radius")
        layout.prop(settings, "brush_mirror", toggle=True)

    @staticmethod
    def draw_cursor(context: bpy.types.Context, tool: object, xy: tuple[int, int]) -> None:
        from gpu_extras.presets import draw_circle_2d

        draw_circle_2d(xy, (1, 1, 1, 1), settings_of(context).brush_radius, segments=48)


class PaintInEditMode(_PaintTool, bpy.types.WorkSpaceTool):
    """Paint faces into the active logo"""

    bl_context_mode = "EDIT_MESH"


class PaintInObjectMode(_PaintTool, bpy.types.WorkSpaceTool):
    """Paint faces into the active logo"""

    bl_context_mode = "OBJECT"


TOOLS = (PaintInEditMode, PaintInObjectMode)


def register() -> None:
    for tool in TOOLS:
        bpy.utils.register_tool(tool, separator=True)


def unregister() -> None:
    for tool in reversed(TOOLS):
        bpy.utils.unregister_tool(tool)
