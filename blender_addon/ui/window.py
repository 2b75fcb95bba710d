# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's window: progress at the mouse pointer for work that it has to wait for, and drawing it again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def progress_cursor(context: bpy.types.Context) -> Iterator[Callable[[float], None]]:
    """Yields `show(fraction)`, 0 to 1, which the pointer shows in percent until the block ends."""
    manager = context.window_manager
    manager.progress_begin(0, 100)
    try:
        yield lambda fraction: manager.progress_update(round(100 * fraction))
    finally:
        manager.progress_end()


def redraw(panels_alone: bool = False) -> None:
    """Redraw the 3D viewports and the preferences; of the viewports the sidebars alone, which is much less work."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D" and panels_alone:
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()
            elif area.type in ("VIEW_3D", "PREFERENCES"):
                area.tag_redraw()
