# SPDX-License-Identifier: GPL-3.0-or-later
"""A cloth that repeats, as fine as it is printed: its picture, packed into the file, on a UV map of ours."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .marks import CLOTH, PREFIX, make_uv_map, remove_layer
from .pictures import load_image

METRES = "cloak.metres"  # of a material that shows a ready cloth: after how many metres it repeats


@dataclass(frozen=True)
class Cloth:
    """A cloth's picture, and where the corners of a mesh lie on it."""

    image: bpy.types.Image
    uv: np.ndarray
    """[C, 2]: v up, beyond [0, 1] the picture repeats."""

    def lay(self, obj: bpy.types.Object) -> bpy.types.Image:
        """Write the UV map; returns the image that is to be shown on it."""
        lay_uv(obj, CLOTH, self.uv)
        self.image.name = PREFIX + CLOTH
        return self.image


def lay_uv(obj: bpy.types.Object, role: str, uv: np.ndarray) -> None:
    """Write our UV map in a role, [C, 2], made where there is none."""
    make_uv_map(obj, role).uv.foreach_set("vector", np.ascontiguousarray(uv, np.float32).ravel())


def load_cloth(path: Path) -> bpy.types.Image:
    """A new image of a picture file, packed. Raises `InputError` where Blender cannot read it."""
    image = load_image(path)
    image.alpha_mode = "NONE"
    image.pack()
    return image


def show_on(material: bpy.types.Material, texture: bpy.types.Node, image: bpy.types.Image, uv_map: str) -> None:
    """Let a material's texture node show an image on a UV map."""
    texture.image = image
    places = material.node_tree.nodes.new("ShaderNodeUVMap")
    places.uv_map = uv_map
    places.location = (texture.location.x - 200, texture.location.y - 200)
    material.node_tree.links.new(places.outputs["UV"], texture.inputs["Vector"])


def cloth_of(material: bpy.types.Material) -> bpy.types.Image | None:
    """The cloth that one of our materials shows; None where it shows colours of faces."""
    nodes = material.node_tree.nodes if material.node_tree else ()
    return next((node.image for node in nodes if node.bl_idname == "ShaderNodeTexImage"), None)


def replace_picture(image: bpy.types.Image, path: Path) -> None:
    """Show a picture file wherever an image is shown, and remove the image."""
    name, new = image.name, load_cloth(path)
    image.user_remap(new)
    bpy.data.images.remove(image)
    new.name = name


def take_off(mesh: bpy.types.Mesh, material: bpy.types.Material) -> None:
    """Remove a cloth that the mesh wore: the UV map, and material and image if nobody else shows them."""
    image = cloth_of(material)
    remove_layer(mesh, CLOTH)
    for thing, kept in ((material, bpy.data.materials), (image, bpy.data.images)):
        if thing is not None and not thing.users:
            kept.remove(thing)


def pixels_at(pixels: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """[n, channels]: pixels [H, W, channels] of a picture that repeats, at texture coordinates [n, 2]."""
    size = np.array(pixels.shape[1::-1])
    column, row = np.minimum((uv % 1 * size).astype(int), size - 1).T
    return pixels[row, column]
