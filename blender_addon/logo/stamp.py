# SPDX-License-Identifier: GPL-3.0-or-later
"""Stamps: a text, a picture or a smiley, and which faces of a body it covers where it is laid.

Ink is a bool array [H, W], row 0 at the top. Only the faces under the stamp and in its box are looked at.
"""

from pathlib import Path

import bpy
import numpy as np

from ..blender.evaluated import Surface
from ..blender.mesh_arrays import box_of, mesh_triangles, vertex_points
from ..blender.occlusion import depth_buffer, seen
from ..blender.pictures import image_pixels
from ..files.errors import InputError

RESOLUTION = 512


def text_stamp(text: str) -> np.ndarray:
    """A line of text in Blender's own font."""
    if not text.strip():
        raise InputError("The stamp's text is empty: type a letter or a word")
    curve = bpy.data.curves.new("cloak stamp", "FONT")
    carrier = bpy.data.objects.new("cloak stamp", curve)
    try:
        curve.body = text
        mesh = carrier.to_mesh()
        if mesh is None or not len(mesh.polygons):
            raise InputError(f"Nothing to see in the text '{text}': the font has no such letters")
        points = vertex_points(mesh) * [1, 1, 0]
        low, high = points.min(0), points.max(0)
        scale = RESOLUTION / max(high - low)
        width, height, _ = np.maximum(1, np.ceil((high - low) * scale)).astype(int).tolist()
        return depth_buffer((points - low) * scale, mesh_triangles(mesh)[0], (width, height))[1][::-1] >= 0
    finally:
        carrier.to_mesh_clear()
        bpy.data.objects.remove(carrier)
        bpy.data.curves.remove(curve)


def smiley_stamp() -> np.ndarray:
    """A ring with two eyes and a mouth."""
    across, down = 2 * (np.mgrid[:RESOLUTION, :RESOLUTION][::-1] + 0.5) / RESOLUTION - 1
    radius = np.hypot(across, down)
    ring = (radius <= 1) & (radius >= 0.78)
    eyes = np.hypot((np.abs(across) - 0.32) / 0.8, down + 0.25) <= 0.17
    mouth = (radius <= 0.60) & (radius >= 0.38) & (down > 0.12)
    return ring | eyes | mouth


def image_stamp(image: bpy.types.Image | None) -> np.ndarray:
    """The dark, opaque pixels of an image."""
    if image is None:
        raise InputError("No picture chosen: open one under Stamp > Image")
    if not image.size[0] or not image.size[1]:
        raise InputError(f"Picture '{image.name}' cannot be read: reload it or choose another")
    pixels = image_pixels(image)[::-1]
    opaque = pixels[..., 3] > 0.5 if image.channels == 4 else np.ones(pixels.shape[:2], bool)
    ink = opaque & (pixels[..., : min(3, image.channels)].mean(-1) < 0.5)
    if not ink.any():
        raise InputError(f"Picture '{image.name}' has no dark, opaque pixels: those are the ink of a stamp")
    return ink


def chosen_stamp(settings: bpy.types.PropertyGroup) -> tuple[np.ndarray, str]:
    """The stamp that is set, and its name."""
    if settings.stamp_kind == "TEXT":
        return text_stamp(settings.stamp_text), settings.stamp_text.strip()
    if settings.stamp_kind == "IMAGE":
        return image_stamp(settings.stamp_image), Path(settings.stamp_image.name).stem
    return smiley_stamp(), "Smiley"


Projection = np.ndarray
"""[3, 4]: along parallel rays from points of the world to stamp coordinates: x and y inside +-1, and inverse depth."""


def laid(place: np.ndarray, direction: np.ndarray, height: float, aspect: float, angle: float = 0.0) -> Projection:
    """A stamp: place of its middle [3], height, turn in radians, and the direction it is stamped along [3]."""
    into = direction / np.linalg.norm(direction)
    level = np.cross([0, 0, 1], -into)
    if np.linalg.norm(level) < 1e-6:  # from straight above or below
        level = np.array([1.0, 0, 0])
    across = level / np.linalg.norm(level)
    above, cos, sin = np.cross(-into, across), np.cos(angle), np.sin(angle)
    rows = np.stack([cos * across + sin * above, cos * above - sin * across, -into])
    rows[:2] /= [[height * aspect / 2], [height / 2]]
    return np.c_[rows, -rows @ place * [1, 1, 0]]


def projected(projection: Projection, points: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Points [n, 3] around `middle` as x, y and inverse depth [n, 3]."""
    return points @ projection[:, :3].T + (projection[:, :3] @ middle + projection[:, 3])


def front_projection(obj: bpy.types.Object, size: float, center: float, offset: float, aspect: float) -> Projection:
    """Straight onto the front. `size` (stamp height), `center` and `offset` are shares of the body's height."""
    low, high = box_of(obj)
    tall = max(float(high[2] - low[2]), 1e-9)
    place = np.array([(low[0] + high[0]) / 2 + offset * tall, low[1], low[2] + center * tall])
    return laid(place, np.array([0.0, 1.0, 0.0]), size * tall, aspect)


class Placed:
    """A stamp, bool [H, W], and the body it is laid on."""

    def __init__(self, surface: Surface, ink: np.ndarray) -> None:
        self.surface, self.ink = surface, ink
        self.aspect = ink.shape[1] / ink.shape[0]

    def own_mask(self, projection: Projection) -> np.ndarray:
        """Mask [F] of the mesh's own faces that the stamp covers; `InputError` where there are none."""
        mask = self.surface.own_mask(self.faces(projection))
        if not mask.any():
            raise InputError("The stamp covers no visible face: change its size or place, or the view")
        return mask

    def faces(self, projection: Projection) -> np.ndarray:
        """The evaluated faces [n] whose centres lie under ink, that look at the viewer and that nothing hides."""
        surface = self.surface
        plane = projected(projection, surface.centers, surface.middle)
        inside = np.flatnonzero((np.abs(plane[:, 0]) <= 1) & (np.abs(plane[:, 1]) <= 1) & surface.shown)
        facing = surface.normals[inside] @ projection[2, :3] > 0
        inside = inside[facing]
        column, row = ((plane[inside, :2] * [1, -1] + 1) / 2 * self.ink.shape[::-1]).astype(int).T
        inside = inside[self.ink[np.minimum(row, len(self.ink) - 1), np.minimum(column, self.ink.shape[1] - 1)]]
        if not len(inside):
            return inside
        points = projected(projection, surface.points, surface.middle)
        low, high = plane[inside, :2].min(0), plane[inside, :2].max(0)
        sides = (points[:, :2] < low) * np.uint8([1, 2]) + (points[:, :2] > high) * np.uint8([4, 8])
        behind = (points[:, 2] < plane[inside, 2].min()) * np.uint8(16)
        beyond, (a, b, c) = sides[:, 0] | sides[:, 1] | behind, surface.corners.T
        near = (beyond[a] & beyond[b] & beyond[c]) == 0  # a triangle beyond one side hides nothing
        return inside[seen(plane[inside], inside, points, surface.corners[near], surface.face[near])]
