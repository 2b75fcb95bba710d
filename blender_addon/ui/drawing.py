# SPDX-License-Identifier: GPL-3.0-or-later
"""Words, rectangles and frames over a viewport, in pixels from its lower left."""

from __future__ import annotations

import bpy

from ..translations import said

Color = tuple[float, float, float]
"""sRGB in [0, 1]."""
POINTS = 12
WHITE: Color = (1.0, 1.0, 1.0)


def size_of_words(context: bpy.types.Context) -> float:
    """Set the size of words to come; returns how much larger than usual the interface is drawn."""
    import blf

    scale = context.preferences.system.ui_scale
    blf.size(0, POINTS * scale)
    return scale


def short(words: str, most: int = 60) -> str:
    """The end of long words: of a path, that is what tells."""
    return words if len(words) <= most else f"…{words[1 - most :]}"


def write(words: str, x: float, y: float, color: Color = WHITE, centered: bool = False) -> None:
    """Words with a shadow, so that they can be read on anything."""
    import blf

    words = said(words)
    if centered:
        x -= blf.dimensions(0, words)[0] / 2
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 5, 0.0, 0.0, 0.0, 0.9)
    blf.color(0, *color, 1.0)
    blf.position(0, x, y, 0)
    blf.draw(0, words)
    blf.disable(0, blf.SHADOW)


def width_of(words: str) -> float:
    """Of words as `write` draws them, pixels."""
    import blf

    return blf.dimensions(0, said(words))[0]


def fill(x: float, y: float, width: float, height: float, color: Color, alpha: float = 1.0) -> None:
    """A filled rectangle."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    batch = batch_for_shader(shader, "TRIS", {"pos": corners}, indices=[(0, 1, 2), (0, 2, 3)])
    gpu.state.blend_set("ALPHA")
    shader.uniform_float("color", (*color, alpha))
    batch.draw(shader)
    gpu.state.blend_set("NONE")


def frame(x1: float, y1: float, x2: float, y2: float, color: Color, thickness: float) -> None:
    """The outline of a rectangle, inwards of its corners."""
    fill(x1, y1, x2 - x1, thickness, color)
    fill(x1, y2 - thickness, x2 - x1, thickness, color)
    fill(x1, y1, thickness, y2 - y1, color)
    fill(x2 - thickness, y1, thickness, y2 - y1, color)
