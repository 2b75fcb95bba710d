# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's window: its viewports, what is drawn over them, its handlers, and progress at the mouse pointer."""

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy

WAITS = {"SCULPT", "TEXTURE_PAINT"}
"""Modes whose strokes cannot be undone any more (Blender 5.2 crashes) once another object has been written."""


class Hooks:
    """Handlers of Blender and drawing over its viewports, from `register` until `unregister`.

    handlers: names in `bpy.app.handlers` and functions. drawing: functions and when they draw ("POST_VIEW",
    "POST_PIXEL"); without a window nothing is drawn. closing: called at the end.
    """

    def __init__(self, *handlers: tuple, drawing: tuple = (), closing: Callable = lambda: None) -> None:
        self._handlers, self._drawing, self._closing = handlers, drawing, closing
        self._drawn: list[object] = []

    def register(self) -> None:
        for name, handler in self._handlers:
            getattr(bpy.app.handlers, name).append(handler)
        if not bpy.app.background:
            add = bpy.types.SpaceView3D.draw_handler_add
            self._drawn = [add(draw, (), "WINDOW", when) for draw, when in self._drawing]

    def unregister(self) -> None:
        while self._drawn:
            bpy.types.SpaceView3D.draw_handler_remove(self._drawn.pop(), "WINDOW")
        for name, handler in self._handlers:
            getattr(bpy.app.handlers, name).remove(handler)
        self._closing()


def areas(*kinds: str) -> Iterator[tuple[bpy.types.Window, bpy.types.Area]]:
    """Every area of these kinds ("VIEW_3D") in every window."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        yield from ((window, area) for area in window.screen.areas if area.type in kinds)


def main_region(area: bpy.types.Area) -> bpy.types.Region | None:
    """The region of an area that shows its content."""
    return next((region for region in area.regions if region.type == "WINDOW"), None)


def redraw(panels_alone: bool = False) -> None:
    """Redraw the 3D viewports and the preferences; of the viewports the sidebars alone, which is much less work."""
    for _, area in areas("VIEW_3D", "PREFERENCES"):
        sidebars = [region for region in area.regions if region.type == "UI"]
        for part in sidebars if panels_alone and area.type == "VIEW_3D" else [area]:
            part.tag_redraw()


def in_window(action: Callable[[], object]) -> bool:
    """Call `action` in the first window; False without a window."""
    windows = bpy.context.window_manager.windows
    if bpy.app.background or not len(windows):
        return False
    with bpy.context.temp_override(window=windows[0]):
        action()
    return True


def tool_at_work() -> str:
    """What the user is in the middle of: a stroke, a grab, one of `WAITS`, a render that locks the interface; or ""."""
    manager = bpy.context.window_manager
    if manager.is_interface_locked:
        return "Render"
    for window in manager.windows:
        active = window.view_layer.objects.active
        if active is not None and active.mode in WAITS:
            return active.bl_rna.properties["mode"].enum_items[active.mode].name
        for operator in window.modal_operators:
            looks_around = operator.bl_idname.startswith("VIEW3D_OT_") and "UNDO" not in operator.bl_options
            if operator.bl_options & {"UNDO", "BLOCKING"} and not looks_around:
                return operator.name
    return ""


def between_strokes(seconds: float, meanwhile: Callable[[], None] = lambda: None) -> Callable:
    """Make a timer's function wait for tools: while one is at work, call `meanwhile` every `seconds` instead.

    What a stroke holds of the scene is gone after a write or an undo step in its middle, and Blender crashes.
    """

    def decorate(function: Callable[[], float | None]) -> Callable[[], float | None]:
        @functools.wraps(function)
        def timer() -> float | None:
            if not tool_at_work():
                return function()
            meanwhile()
            return seconds

        return timer

    return decorate


@between_strokes(1.0)
def end_notice() -> None:
    """The timer's function: take a message out of the status bar."""
    tell_status("")


def tell_status(words: str) -> None:
    """Show a line in the status bar of every window; "" brings Blender's own back."""
    for window in bpy.context.window_manager.windows:
        window.workspace.status_text_set(words or None)


@contextmanager
def progress_cursor() -> Iterator[None]:
    """Let the mouse pointer show in percent what `show_progress` is told in the block."""
    bpy.context.window_manager.progress_begin(0, 100)
    try:
        yield
    finally:
        bpy.context.window_manager.progress_end()


def show_progress(fraction: float) -> None:
    """Say how far a long action is, 0 to 1; outside of a `progress_cursor` nobody sees it."""
    bpy.context.window_manager.progress_update(round(100 * fraction))
