# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures as arrays: pixels as stored (display colours, straight alpha), bottom row first, as Blender keeps them."""

from pathlib import Path

import bpy
import numpy as np

from ..files.errors import InputError


def load_image(path: Path) -> bpy.types.Image:
    """A new image of a picture file. Raises `InputError` where Blender cannot read it."""
    try:
        image = bpy.data.images.load(str(path), check_existing=False)
    except RuntimeError:
        raise InputError(f"{path}: cannot be read") from None
    if not image.size[0]:
        bpy.data.images.remove(image)
        raise InputError(f"{path}: not a picture that Blender can read")
    return image


def image_pixels(image: bpy.types.Image) -> np.ndarray:
    """[H, W, channels] float32."""
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], image.channels)


def read_picture(path: Path, cover: tuple[int, int] | None = None) -> np.ndarray:
    """[H, W, channels] of a picture file; scaled and cropped to `cover`, width and height. Raises `InputError`."""
    image = load_image(path)
    try:
        if not cover:
            return image_pixels(image)
        scale = max(cover[0] / image.size[0], cover[1] / image.size[1])
        image.scale(*(int(np.ceil(side * scale)) for side in image.size))
        x, y = ((side - wanted) // 2 for side, wanted in zip(image.size, cover, strict=True))
        return image_pixels(image)[y : y + cover[1], x : x + cover[0]]
    finally:
        bpy.data.images.remove(image)


def new_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """A new image of pixels [H, W, 3] or, with alpha, [H, W, 4]; not packed."""
    height, width, channels = pixels.shape
    image = bpy.data.images.new(name, width, height, alpha=channels == 4)
    if channels < 4:
        pixels = np.append(pixels, np.ones((height, width, 1)), axis=2)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.update()
    return image


def show_preview(owner: bpy.types.ID, pixels: np.ndarray) -> None:
    """Let an asset be shown by pixels [H, W, 4]."""
    preview = owner.preview_ensure()
    preview.image_size = pixels.shape[1::-1]
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(pixels).ravel())


def save_picture(path: Path, pixels: np.ndarray) -> None:
    """Write pixels [H, W, 3 or 4] as a PNG."""
    image = new_image(path.stem, pixels)
    try:
        image.filepath_raw, image.file_format = str(path), "PNG"
        image.save()
    finally:
        bpy.data.images.remove(image)
