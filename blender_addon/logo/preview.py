# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces shown over the body while the user still drags: what a stroke or a stamp will take."""

from __future__ import annotations

import bpy
import numpy as np

from ..blender.surface import Surface
from ..ui.drawing import Shape
from ..ui.window import Hooks
from .overlay import LIFT

MOVES = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}
"""Events of a mouse that moves."""
ADDED, TAKEN = (0.2, 0.9, 1.0, 0.55), (0.05, 0.05, 0.05, 0.6)


class Preview(Hooks):
    """Drawn in every 3D viewport from `register` to `unregister`; without a window nothing is drawn."""

    def __init__(self, surface: Surface, color: tuple[float, float, float, float]) -> None:
        self._surface, self._color = surface, color
        self._shapes: list[Shape] = []
        self._lift = LIFT * float(np.ptp(surface.points, axis=0).max())
        super().__init__(drawing=((self._draw, "POST_VIEW"),), closing=self._shapes.clear)

    def replace(self, faces: np.ndarray) -> None:
        """Show these evaluated faces alone."""
        self._shapes.clear()
        self.add(faces)

    def add(self, faces: np.ndarray) -> None:
        """Show these evaluated faces as well."""
        if bpy.app.background or not len(faces):
            return
        surface = self._surface
        triangles, face = surface.triangles(faces)
        normals = surface.normals[face]
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        corners = surface.points[triangles] + self._lift * normals[:, None]
        self._shapes.append(Shape("TRIS", corners.reshape(-1, 3) + surface.middle, self._color))

    def _draw(self) -> None:
        for shape in self._shapes:
            shape.draw()
