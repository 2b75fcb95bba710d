# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces shown over the body while the user still drags: what a stroke or a stamp will take."""

from __future__ import annotations

import bpy
import numpy as np

from ..blender.surface import Surface
from .overlay import LIFT

ADDED, TAKEN = (0.2, 0.9, 1.0, 0.55), (0.05, 0.05, 0.05, 0.6)


class Preview:
    """Drawn in every 3D viewport from `begin` to `end`; without a window nothing is drawn."""

    def __init__(self, surface: Surface, color: tuple[float, float, float, float]) -> None:
        self._surface, self._color = surface, color
        self._batches: list[object] = []
        self._handle: object | None = None
        self._lift = LIFT * float(np.ptp(surface.points, axis=0).max())

    def begin(self) -> None:
        if not bpy.app.background:
            self._handle = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", "POST_VIEW")

    def end(self) -> None:
        if self._handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
        self._handle = None
        self._batches.clear()

    def replace(self, faces: np.ndarray) -> None:
        """Show these evaluated faces alone."""
        self._batches.clear()
        self.add(faces)

    def add(self, faces: np.ndarray) -> None:
        """Show these evaluated faces as well."""
        if self._handle is None or not len(faces):
            return
        import gpu
        from gpu_extras.batch import batch_for_shader

        surface = self._surface
        triangles, face = surface.triangles(faces)
        normals = surface.normals[face] / np.maximum(
            np.linalg.norm(surface.normals[face], axis=1, keepdims=True), 1e-30
        )
        corners = surface.points[triangles] + self._lift * normals[:, None]
        places = (corners.reshape(-1, 3) + surface.middle).astype(np.float32)
        self._batches.append(batch_for_shader(gpu.shader.from_builtin("UNIFORM_COLOR"), "TRIS", {"pos": places}))

    def _draw(self) -> None:
        import gpu

        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        gpu.state.blend_set("ALPHA")
        gpu.state.depth_test_set("LESS_EQUAL")
        shader.uniform_float("color", self._color)
        for batch in self._batches:
            batch.draw(shader)
        gpu.state.blend_set("NONE")
        gpu.state.depth_test_set("NONE")
