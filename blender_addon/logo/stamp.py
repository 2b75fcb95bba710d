# SPDX-License-Identifier: GPL-3.0-or-later
"""Stamps: a text, a picture or a smiley as a bool array [H, W], row 0 at the top, True where there is ink."""

from __future__ import annotations

import bpy
import numpy as np

from ..blender.mesh_arrays import image_pixels, mesh_triangles, read
from ..blender.occlusion import depth_buffer
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
        return _fill(read(mesh.vertices, "co", 3)[:, :2], mesh_triangles(mesh)[0])
    finally:
        carrier.to_mesh_clear()
        bpy.data.objects.remove(carrier)
        bpy.data.curves.remove(curve)


def _fill(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    low, high = points.min(0), points.max(0)
    scale = RESOLUTION / max(high - low)
    width, height = np.maximum(1, np.ceil((high - low) * scale)).astype(int)
    flat = np.concatenate([(points - low) * scale, np.zeros((len(points), 1))], 1)
    return depth_buffer(flat, triangles, (width, height))[1][::-1] >= 0


def smiley_stamp() -> np.ndarray:
    """A ring with two eyes and a mouth."""
    y, x = 1 - 2 * (np.mgrid[:RESOLUTION, :RESOLUTION] + 0.5) / RESOLUTION
    x = -x
    radius = np.hypot(x, y)
    ring = (radius <= 1) & (radius >= 0.78)
    eyes = np.hypot((np.abs(x) - 0.32) / 0.8, y - 0.25) <= 0.17
    mouth = (np.hypot(x, y) <= 0.60) & (np.hypot(x, y) >= 0.38) & (y < -0.12)
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


def under_ink(plane: np.ndarray, stamp: np.ndarray) -> np.ndarray:
    """Mask [n] of the points [n, 2 or more], the stamp inside +-1, that lie under ink."""
    height, width = stamp.shape
    column = np.floor((plane[:, 0] + 1) / 2 * width).astype(int)
    row = np.floor((1 - plane[:, 1]) / 2 * height).astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return inside & stamp[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
