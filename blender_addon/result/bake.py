# SPDX-License-Identifier: GPL-3.0-or-later
"""The cloak as an image, for programs that know no colour attributes: on the body's own UV map where that has the room.

Every texel whose middle lies in a face takes that face's colour; around the islands colours go on for a few texels, so
that filtering finds no edge. A UV map of Cloak's own gives every face a square of texels.
"""

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ..blender import colors
from ..blender.marks import CLOTH, COLORS, UV_MAP, lay_uv, layer_name, our_names
from ..blender.mesh_arrays import (
    corner_counts,
    mean_of_corners,
    read,
    require_object_mode,
    triangle_areas,
    triangle_corners,
)
from ..blender.occlusion import areas_around_origin, depth_buffer
from ..blender.pictures import image_pixels, new_image, pixels_at, show_on, show_preview
from ..files.errors import InputError
from ..ui.window import show_progress

MARGIN = 4  # texels by which colours go on beyond the islands
OFF = 4 / 255  # largest colour error of a face in the image
FEW = 0.005  # share of wrong faces above which Cloak makes its own UV map
MOST_AREA = 4.0  # unit squares: where faces overlap more, nothing of the map can be used, and it would take long
PREVIEW = 128  # pixels along each side of an asset's, about
FEWEST = 3  # texels along a face's square, at least


@dataclass(frozen=True)
class Baked:
    """An image, packed into the file, and how true it is."""

    image: bpy.types.Image
    uv_map: str
    off: int  # faces whose colour in the image is off by more than 4/255
    off_before: int | None = None  # wrong faces on the body's own UV map, if Cloak made another; else None


def bake(obj: bpy.types.Object, size: int) -> Baked:
    """An image of what the body wears; makes a map of ours where the body has none, or one with too little room."""
    mesh = obj.data
    require_object_mode(obj, "Leave {mode} to bake the cloak")
    if not layer_name(mesh, COLORS):
        raise InputError(f"'{obj.name}' wears no trained colours: press Load Colours first")
    wanted, before = colors.written_colors(obj), None
    ours = our_names(mesh)
    maps = (layer for layer in (mesh.uv_layers.active, *mesh.uv_layers) if layer and layer.name not in ours)
    users = next(maps, None)
    if users is not None:
        places = np.c_[read(users.uv, "vector", 2), np.zeros(len(mesh.loops))]
        if triangle_areas(places, triangle_corners(mesh)[0]).sum() > MOST_AREA:
            users = None
    if users is not None:
        name = users.name
        pixels = _on_map(mesh, name, wanted, size)
        off = faces_off(mesh, name, pixels, wanted)
        if off > FEW * len(wanted):
            before, users = off, None
    if users is None:
        name, pixels = _on_own_map(obj, wanted, size)
        off = faces_off(mesh, name, pixels, wanted)
    show_progress(0.6)
    _sew(mesh, name, pixels)
    show_progress(0.7)
    image = new_image(f"{obj.name} cloak", pixels)
    show_progress(0.8)
    image.pack()
    show_progress(0.9)
    return Baked(image, name, off, before)


def faces_off(mesh: bpy.types.Mesh, uv_map: str, pixels: np.ndarray, wanted: np.ndarray) -> int:
    """How many faces find a colour in the image [S, S, 4], in the middle of their place, that is off [F, 3]."""
    size = len(pixels)
    middle = np.nan_to_num(mean_of_corners(corner_counts(mesh), read(mesh.uv_layers[uv_map].uv, "vector", 2)), nan=-1)
    outside = ((middle < 0) | (middle > 1)).any(1)
    x, y = np.clip((middle * size).astype(int), 0, size - 1).T
    return int((outside | (np.abs(pixels[y, x, :3] - wanted) > OFF).any(1)).sum())


def _on_map(mesh: bpy.types.Mesh, uv_map: str, wanted: np.ndarray, size: int) -> np.ndarray:
    """[S, S, 4]: the colours on a UV map of the user's; beyond the islands they go on by `MARGIN` texels."""
    loops, owner = triangle_corners(mesh)
    tell = lambda share: show_progress(0.4 * share)
    face = rasterize(read(mesh.uv_layers[uv_map].uv, "vector", 2)[loops], owner, size, tell)
    for number in range(MARGIN):
        before = face.copy()
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            face = np.where(face < 0, np.roll(before, step, axis), face)
        show_progress(0.4 + 0.15 * (number + 1) / MARGIN)
    pixels = np.append(wanted, np.ones((len(wanted), 1), np.float32), axis=1)[face]
    pixels[face < 0] = 0
    return pixels


def _sew(mesh: bpy.types.Mesh, uv_map: str, pixels: np.ndarray) -> None:
    """Where the mesh wears a cloth, give the texels of its faces [S, S, 4] the cloth's colours for the faces' means."""
    image, worn = colors.worn_cloth(mesh)
    if image is None:
        return
    corners, face = triangle_corners(mesh)
    corners = corners[worn[face]]
    places = read(mesh.uv_layers[uv_map].uv, "vector", 2)[corners].astype(float) * len(pixels)
    triangle = rasterize(places / len(pixels), np.arange(len(corners)), len(pixels))
    y, x = np.nonzero(triangle >= 0)
    triangle = triangle[y, x]
    # Barycentric coordinates of the texels' middles.
    parts = areas_around_origin(*(places[triangle, corner] - np.stack([x, y], 1) - 0.5 for corner in range(3)))
    weights = (parts / parts.sum(0)).T
    sewn = read(mesh.uv_layers[layer_name(mesh, CLOTH)].uv, "vector", 2)[corners[triangle]]
    pixels[y, x, :3] = pixels_at(image_pixels(image), (sewn * weights[..., None]).sum(1))[:, :3]


def _on_own_map(obj: bpy.types.Object, wanted: np.ndarray, size: int) -> tuple[str, np.ndarray]:
    """A UV map of ours with a square of texels for each face, its corners half a texel inside; and the image [S, S, 4].

    Raises `InputError` where the squares would be too small.
    """
    counts = corner_counts(obj.data)
    side = int(np.ceil(len(counts) ** 0.5))
    step = size // side
    if step < FEWEST:
        raise InputError(f"{len(counts):,} faces need at least {FEWEST * side} texels along each side: raise Size")
    face = np.repeat(np.arange(len(counts)), counts)
    turn = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    angle = 2 * np.pi * (turn + 0.5) / counts[face]
    around = np.stack([np.cos(angle), np.sin(angle)], -1)
    around /= np.abs(around).max(1, keepdims=True)  # from a circle onto the square
    middle = (np.stack([face % side, face // side], -1) + 0.5) * step
    name = lay_uv(obj, UV_MAP, (middle + around * (step / 2 - 0.5)) / size)
    along = np.minimum(np.arange(size, dtype=np.int32) // step, side - 1)
    face_of_texel = np.minimum(along[:, None] * np.int32(side) + along, len(counts) - 1)
    return name, np.append(wanted, np.ones((len(wanted), 1), np.float32), axis=1)[face_of_texel]


def rasterize(
    places: np.ndarray, triangle_face: np.ndarray, size: int, tell: Callable[[float], None] = lambda share: None
) -> np.ndarray:
    """Texture coordinates [T, 3, 2] of faces [T] onto texels [size, size]: one of their faces, -1 for none.

    Row 0 is at the bottom, as Blender stores images. Triangles beyond the unit square are cut off. tell: called with
    the share that is done.
    """
    points = np.concatenate([places.reshape(-1, 2) * size, np.zeros((3 * len(places), 1))], 1)
    _, owner = depth_buffer(points, np.arange(len(points)).reshape(-1, 3), (size, size), tell)
    return np.where(owner >= 0, triangle_face[owner], -1)


def baked_material(image: bpy.types.Image, uv_map: str) -> bpy.types.Material:
    """A material that shows the image on a UV map, marked as an asset, so that the asset browser offers it."""
    material, texture = colors.new_material(image.name, "ShaderNodeTexImage")
    show_on(material, texture, image, uv_map)
    material.asset_mark()
    material.asset_data.description = "Trained colours on the texture coordinates of the body they were trained on"
    # The image itself: Blender would render the material, half a minute and gigabytes without a graphics card, and an
    # undo in the meantime waits for it.
    step = max(1, image.size[0] // PREVIEW)
    show_preview(material, image_pixels(image)[::step, ::step])
    return material


def baked_copy(obj: bpy.types.Object, size: int) -> bpy.types.Object:
    """A copy of an object beside it, all of whose faces show its colours as an image; as it is where it has none.

    Faces that wear a cloth show the cloth itself, on its own UV map.
    """
    done = bake(obj, size) if layer_name(obj.data, COLORS) else None
    copy = obj.copy()
    copy.data = obj.data.copy()
    if done is not None:
        copy.data.materials.clear()
        copy.data.materials.append(baked_material(done.image, done.uv_map))
        image, worn = colors.worn_cloth(obj.data)
        if image is not None:
            copy.data.materials.append(colors.cloak_material(copy.data, colors.LOOKDEV, image))
        copy.data.polygons.foreach_set("material_index", worn.astype(np.int32) * (image is not None))
    for collection in obj.users_collection:
        collection.objects.link(copy)
    return copy
