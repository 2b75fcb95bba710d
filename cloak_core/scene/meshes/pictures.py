"""Several pictures and plain colours put together as one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Integer, UInt8

from cloak_core.files.errors import InputError
from cloak_core.scene.pictures import MAX_PIXELS

CELL = 4
"""Side in pixels of a plain colour's square in a picture put together from several."""


def put_together(
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    picture_of: Integer[np.ndarray, " faces"],
    plain: Float[np.ndarray, "faces 3"],
    corner_uv: Float[np.ndarray, "corners 2"],
    loop_total: Integer[np.ndarray, " faces"],
) -> tuple[UInt8[np.ndarray, "h w 3"], Float[np.ndarray, "corners 2"]]:
    """Several pictures, and squares of plain colours, as one; and every corner's texture coordinates in it.

    picture_of: the picture of each face, -1 where it is plain; plain: the faces' colours where they are. A face that
    reaches over a picture's border, where it would repeat, is held at the border.
    """
    colors = np.rint(np.clip(plain, 0, 1) * 255).astype(np.uint8)
    palette, cell = np.unique(colors, axis=0, return_inverse=True)
    width = max([image.shape[1] for image in pictures] + [CELL])
    across = width // CELL
    tops = np.cumsum([0] + [image.shape[0] for image in pictures])
    height = int(tops[-1]) + CELL * -(-len(palette) // across)
    if width * height > MAX_PIXELS:
        raise InputError(f"its pictures put together have more than {MAX_PIXELS >> 20} million pixels")
    whole = np.zeros((height, width, 3), np.uint8)
    for image, top in zip(pictures, tops, strict=False):
        whole[top : top + image.shape[0], : image.shape[1]] = image
    row, column = int(tops[-1]) + np.arange(len(palette)) // across * CELL, np.arange(len(palette)) % across * CELL
    for step in range(CELL * CELL):
        whole[row + step // CELL, column + step % CELL] = palette
    starts = np.cumsum(loop_total) - loop_total
    lowest = np.floor(np.minimum.reduceat(corner_uv, starts, axis=0) + 1e-6)
    within = corner_uv - np.repeat(lowest, loop_total, axis=0)
    number = np.repeat(picture_of, loop_total)
    cell = np.repeat(cell.reshape(-1), loop_total)
    at = np.stack([column[cell], row[cell]], axis=1) + CELL / 2
    for index, image in enumerate(pictures):
        mine = number == index
        size = np.array(image.shape[1::-1])
        here = np.stack([within[mine, 0], 1 - within[mine, 1]], axis=1) * size
        at[mine] = np.clip(here, 0.5, size - 0.5) + np.array([0, tops[index]])
    return whole, at / [width, height] * [1, -1] + [0, 1]
