# SPDX-License-Identifier: GPL-3.0-or-later
"""Asking Blender to draw its window again."""

from __future__ import annotations

import bpy


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
