# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing: words and rectangles over a viewport, triangles and lines in its space, and pictures in the panels."""

import functools
from pathlib import Path

import blf
import bpy
import bpy.utils.previews
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix

from ..translations import said
from .window import Hooks

Color = tuple[float, float, float]  # sRGB in [0, 1]
POINTS = 12
LINE_PIXELS = 2.0
WHITE: Color = (1.0, 1.0, 1.0)


def size_of_words(context: bpy.types.Context) -> float:
    """Set the size of words to come; returns how much larger than usual the interface is drawn."""
    scale = context.preferences.system.ui_scale
    blf.size(0, POINTS * scale)
    return scale


def short(words: str, most: int = 60) -> str:
    """Shorten a text to its end, which identifies a path."""
    return words if len(words) <= most else f"…{words[1 - most :]}"


def write(words: str, x: float, y: float, color: Color = WHITE, centered: bool = False) -> None:
    """Words with a shadow, so that they can be read on anything."""
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
    """Width in pixels of words drawn by `write`."""
    return blf.dimensions(0, said(words))[0]


class Shape:
    """Triangles ("TRIS") or lines ("LINES") over a viewport: corners [n, 3]; one RGBA colour, or one each [n, 4]."""

    def __init__(self, kind: str, corners: np.ndarray, color: np.ndarray | tuple[float, ...]) -> None:
        self._lines, self._color = kind == "LINES", color if np.ndim(color) == 1 else None
        name = "POLYLINE_UNIFORM_COLOR" if self._lines else "UNIFORM_COLOR" if self._color else "SMOOTH_COLOR"
        self._shader = gpu.shader.from_builtin(name)
        colors = {} if self._color else {"color": np.asarray(color, np.float32)}
        self._batch = batch_for_shader(self._shader, kind, {"pos": np.asarray(corners, np.float32), **colors})

    def draw(self, matrix: Matrix | None = None, on_top: bool = False) -> None:
        """Draw it through a matrix; behind what lies before it, unless `on_top`."""
        gpu.state.depth_test_set("NONE" if on_top else "LESS_EQUAL")
        gpu.state.blend_set("ALPHA")
        with gpu.matrix.push_pop():
            gpu.matrix.multiply_matrix(matrix or Matrix())
            if self._lines:
                region, scale = bpy.context.region, bpy.context.preferences.system.ui_scale
                self._shader.uniform_float("viewportSize", (region.width, region.height))
                self._shader.uniform_float("lineWidth", LINE_PIXELS * scale)
            if self._color:
                self._shader.uniform_float("color", self._color)
            self._batch.draw(self._shader)
        gpu.state.blend_set("NONE")
        gpu.state.depth_test_set("NONE")


def fill(x: float, y: float, width: float, height: float, color: Color, alpha: float = 1.0) -> None:
    """A filled rectangle."""
    a, b, c, d = (x, y, 0), (x + width, y, 0), (x + width, y + height, 0), (x, y + height, 0)
    Shape("TRIS", np.array([a, b, c, a, c, d]), (*color, alpha)).draw(on_top=True)


def frame(x1: float, y1: float, x2: float, y2: float, color: Color, thickness: float) -> None:
    """The outline of a rectangle, inwards of its corners."""
    fill(x1, y1, x2 - x1, thickness, color)
    fill(x1, y2 - thickness, x2 - x1, thickness, color)
    fill(x1, y1, thickness, y2 - y1, color)
    fill(x2 - thickness, y1, thickness, y2 - y1, color)


_names: dict[Path, str] = {}  # what each file is called among the previews, which hold it as it last was
_previews = functools.cache(bpy.utils.previews.new)


def icon_of(path: Path) -> int:
    """The icon that shows a picture; 0 where there is none."""
    if not path.is_file():
        return 0
    pictures, name = _previews(), f"{path} {path.stat().st_mtime_ns}"
    if name not in pictures:
        if path in _names:
            del pictures[_names[path]]
        pictures.load(name, str(path), "IMAGE")
        _names[path] = name
    return pictures[name].icon_id


def _forget() -> None:
    bpy.utils.previews.remove(_previews())
    _previews.cache_clear()
    _names.clear()


HOOKS = Hooks(closing=_forget)
