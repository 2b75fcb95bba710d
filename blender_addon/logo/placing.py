# SPDX-License-Identifier: GPL-3.0-or-later
"""A stamp somewhere on a body: which faces it takes there, quickly enough to follow the mouse.

Only the faces under the stamp and in its box are looked at, out of the arrays that were read once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..blender.occlusion import seen
from ..blender.surface import Surface
from .stamp import under_ink


@dataclass(frozen=True)
class Placement:
    """Where and how a stamp lies: its middle [3], the way into the body [3], its height, its turn in radians."""

    place: np.ndarray
    direction: np.ndarray
    height: float
    angle: float = 0.0

    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Right, up and towards the viewer, [3] each, of length one."""
        toward = -self.direction / np.linalg.norm(self.direction)
        level = np.cross([0, 0, 1], toward)
        if np.linalg.norm(level) < 1e-6:  # from straight above or below
            level = np.array([1.0, 0, 0])
        right = level / np.linalg.norm(level)
        up = np.cross(toward, right)
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        return cos * right + sin * up, cos * up - sin * right, toward


class Placed:
    """A stamp, bool [H, W], and the body it is laid on."""

    def __init__(self, surface: Surface, ink: np.ndarray) -> None:
        self.surface, self.ink = surface, ink
        self._visible = np.zeros(len(surface.centers), np.int8)
        """1 where a face is known to be seen from `_direction`, -1 where it is known to be hidden, 0 else."""
        self._direction = np.zeros(3)

    def faces(self, placement: Placement) -> np.ndarray:
        """The evaluated faces [n] whose centres lie under ink, that look at the viewer and that nothing hides."""
        surface = self.surface
        right, up, toward = placement.axes()
        middle = (placement.place - surface.middle).astype(np.float32)
        half = np.array([placement.height * self.ink.shape[1] / self.ink.shape[0], placement.height]) / 2
        frame = np.stack([right / half[0], up / half[1]], 1).astype(np.float32)
        plane = (surface.centers - middle) @ frame
        inside = np.flatnonzero((np.abs(plane) <= 1).all(1) & surface.shown)
        inside = inside[(surface.normals[inside] @ toward.astype(np.float32) > 0) & under_ink(plane[inside], self.ink)]
        return inside[self._seen(inside, right, up, toward)]

    def _seen(self, faces: np.ndarray, right: np.ndarray, up: np.ndarray, toward: np.ndarray) -> np.ndarray:
        """Mask [n]; a parallel view from one side hides the same faces wherever the stamp is, so it is asked once."""
        if not np.array_equal(toward, self._direction):
            self._direction = toward
            self._visible[:] = 0
        new = faces[self._visible[faces] == 0]
        if len(new):
            self._visible[new] = np.where(self._look(new, np.stack([right, up, toward], 1)), 1, -1)
        return self._visible[faces] > 0

    def _look(self, faces: np.ndarray, axes: np.ndarray) -> np.ndarray:
        surface = self.surface
        places = surface.centers @ axes.astype(np.float32)
        low, high = places[faces, :2].min(0), places[faces, :2].max(0)
        reach = surface.reach[:, None]
        near = ((places[:, :2] >= low - reach) & (places[:, :2] <= high + reach)).all(1)
        near &= places[:, 2] >= places[faces, 2].min() - surface.reach  # what lies behind all hides none
        triangles, face = surface.triangles(np.flatnonzero(near))
        used, renumbered = np.unique(triangles, return_inverse=True)
        corners = surface.points[used].astype(np.float64) @ axes
        centers = surface.centers[faces].astype(np.float64) @ axes
        return seen(centers, faces, corners, renumbered.reshape(-1, 3), face)


def area_of(surface: Surface) -> float:
    """The body's whole area, in world units squared."""
    triangles, _ = surface.triangles(np.arange(len(surface.centers)))
    first, second, third = (surface.points[triangles[:, corner]] for corner in range(3))
    return float(np.linalg.norm(np.cross(second - first, third - first), axis=1).sum() / 2)
