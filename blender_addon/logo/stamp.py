# SPDX-License-Identifier: GPL-3.0-or-later
"""Stamps: a text, a picture or a smiley as a bool array [H, W], row 0 at the top, True where there is ink."""

from __future__ import annotations

import bpy
import numpy as np

from ..blender.mesh_arrays import image_pixels, mesh_triangles, read
from ..blender.occlusion import ranges
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
    pixels = (points - low) * scale
    row, left, right = _spans(pixels[triangles])
    row, left, right = (values[(row >= 0) & (row < height) & (left <= right)] for values in (row, left, right))
    steps = np.zeros((height, width + 1), np.int32)
    np.add.at(steps, (row, np.clip(left, 0, width)), 1)
    np.add.at(steps, (row, np.clip(right + 1, 0, width)), -1)
    return (steps.cumsum(1)[:, :width] > 0)[::-1]


def _spans(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of triangles [T, 3, 2]: each row of pixels that one crosses, and the first and last pixel covered there."""
    low = np.ceil(triangles[..., 1].min(1) - 0.5).astype(np.int64)
    high = np.floor(triangles[..., 1].max(1) - 0.5).astype(np.int64)
    triangle, row = ranges(np.arange(len(triangles)), low, np.maximum(high - low + 1, 0))
    start, end = triangles[triangle], np.roll(triangles, -1, axis=1)[triangle]
    with np.errstate(divide="ignore", invalid="ignore"):  # level sides meet no row, or all of it
        along = (row[:, None] + 0.5 - start[..., 1]) / (end[..., 1] - start[..., 1])
        x = start[..., 0] + along * (end[..., 0] - start[..., 0])
    met = (along >= 0) & (along <= 1)
    left, right = np.where(met, x, np.inf).min(1), np.where(met, x, -np.inf).max(1)
    some = met.any(1)
    first, last = np.ceil(left[some] - 0.5), np.floor(right[some] - 0.5)
    return row[some], first.astype(np.int64), last.astype(np.int64)


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
