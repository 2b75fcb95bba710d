# SPDX-License-Identifier: GPL-3.0-or-later
"""The cloak as an image on the body's own texture coordinates, for programs that know no colour attributes.

Every texel whose middle lies in a face takes that face's colour; around the islands colours go on for a few texels, so
that filtering finds no edge.
"""

from __future__ import annotations

import bpy
import numpy as np

from . import colors
from .files.errors import InputError
from .mesh_arrays import mesh_triangles, read
from .occlusion import cells_touched

MARGIN = 4
"""Texels by which colours go on beyond the islands."""


def bake(obj: bpy.types.Object, size: int) -> tuple[bpy.types.Image, float]:
    """An image of what the body wears, packed into the file, and the share of its texels that several faces claim."""
    mesh = obj.data
    if obj.mode == "EDIT":
        raise InputError("Leave Edit Mode (Tab) to bake the cloak")
    if colors.CLOAK not in mesh.color_attributes:
        raise InputError(f"'{obj.name}' wears no trained colours: press Load Colours first")
    if mesh.uv_layers.active is None:
        raise InputError(f"'{obj.name}' has no UV map: unwrap it first (Edit Mode, U > Smart UV Project)")
    mesh.calc_loop_triangles()
    loops = read(mesh.loop_triangles, "loops", 3, np.int32)
    places = read(mesh.uv_layers.active.uv, "vector", 2)[loops]
    face, claims = rasterize(places, mesh_triangles(mesh)[1], size)
    if not claims.any():
        raise InputError(f"The UV map of '{obj.name}' lies outside the image: unwrap it again")
    pixels = np.zeros((size, size, 4), np.float32)
    pixels[claims > 0, :3] = colors.read_face_colors(obj, colors.CLOAK)[face[claims > 0]]
    pixels[claims > 0, 3] = 1
    image = bpy.data.images.new(f"{obj.name} cloak", size, size, alpha=True)
    image.pixels.foreach_set(_spread(pixels).ravel())
    image.update()
    image.pack()
    return image, float((claims > 1).sum() / (claims > 0).sum())


def rasterize(places: np.ndarray, triangle_face: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Texture coordinates [T, 3, 2] of faces [T] onto texels: a face of each [size, size], how many faces claim it.

    Row 0 is at the bottom, as Blender stores images. Triangles beyond the unit square are cut off.
    """
    corners = places * size - 0.5  # texel middles at whole numbers
    low = np.clip(np.ceil(corners.min(1)), 0, size).astype(np.int64)
    high = np.clip(np.floor(corners.max(1)), -1, size - 1).astype(np.int64)
    some = np.flatnonzero((high >= low).all(1))
    texel, triangle = cells_touched(low[some], high[some], size)
    triangle = some[triangle]
    points = np.stack([texel % size, texel // size], -1)
    sides = []
    for corner in range(3):
        a, b = corners[triangle, corner], corners[triangle, (corner + 1) % 3]
        sides.append((b[:, 0] - a[:, 0]) * (points[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (points[:, 0] - a[:, 0]))
    inside = (np.minimum.reduce(sides) >= 0) | (np.maximum.reduce(sides) <= 0)
    claimed = np.unique(texel[inside] * len(places) + triangle_face[triangle[inside]])
    texel, owner = claimed // len(places), claimed % len(places)
    face = np.zeros(size * size, np.int64)
    face[texel] = owner
    return face.reshape(size, size), np.bincount(texel, minlength=size * size).reshape(size, size)


def _spread(pixels: np.ndarray) -> np.ndarray:
    """Colours go on beyond the islands by `MARGIN` texels."""
    for _ in range(MARGIN):
        empty = pixels[..., 3] == 0
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            beside = np.roll(pixels, step, axis)
            taken = empty & (beside[..., 3] > 0) & (pixels[..., 3] == 0)
            pixels[taken] = beside[taken]
    return pixels


def baked_material(image: bpy.types.Image) -> bpy.types.Material:
    """A material that shows the image on the active UV map, marked as an asset, so that the asset browser offers it."""
    material = bpy.data.materials.new(image.name)
    nodes, links = colors.nodes_of(material)
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 0.6
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = image
    texture.location = (shader.location.x - 320, shader.location.y)
    links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    material.asset_mark()
    material.asset_data.description = "Trained colours on the texture coordinates of the body they were trained on"
    if not bpy.app.background:
        material.asset_generate_preview()
    return material
