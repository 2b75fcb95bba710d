"""The pictures of a mesh file, with its plain colours, as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Integer, UInt8

from cloak_core.core.pictures import MAX_PIXELS
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.mesh_file import MeshFile

CELL = 4
"""Side in pixels of a plain colour's square in a picture put together from several."""


def with_pictures(
    path: Path,
    mesh: MeshFile,
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    picture_of: Integer[np.ndarray, " faces"],
    corner_uv: Float[np.ndarray, "corners 2"],
) -> MeshFile:
    """Give the mesh one picture: the only one of all faces, or all of them and the plain colours put together.

    picture_of: the picture of each face, -1 where it is plain; corner_uv: NaN where a corner has no coordinates.
    InputError: a face that has a picture, but no coordinates.
    """
    used = np.unique(picture_of)
    if not len(used) or used[-1] < 0:
        return mesh
    missing = np.flatnonzero((np.repeat(picture_of, mesh.loop_total) >= 0) & ~np.isfinite(corner_uv).all(axis=1))
    if len(missing):
        face = int(np.searchsorted(np.cumsum(mesh.loop_total), missing[0], side="right"))
        raise InputError(f"{path}: face {face} has a texture but no texture coordinates (UVs)")
    if len(used) == 1:
        return replace(mesh, picture=pictures[used[0]])
    picture, corner_uv = put_together(pictures, picture_of, mesh.face_colors, np.nan_to_num(corner_uv), mesh.loop_total)
    return replace(mesh, picture=picture, uv=corner_uv, loop_uv=np.arange(len(corner_uv)))


def put_together(
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    picture_of: Integer[np.ndarray, " faces"],
    plain: Float[np.ndarray, "faces 3"],
    corner_uv: Float[np.ndarray, "corners 2"],
    loop_total: Integer[np.ndarray, " faces"],
) -> tuple[UInt8[np.ndarray, "h w 3"], Float[np.ndarray, "corners 2"]]:
    """Put several pictures and squares of plain colours together; locate every corner's coordinates in it.

    picture_of: the picture of each face, -1 where it is plain; plain: the faces' colours where they are. A face that
    reaches over a picture's border, where it would repeat, is held at the border.
    """
    width = max([image.shape[1] for image in pictures] + [CELL])
    tops = np.cumsum([0] + [image.shape[0] for image in pictures])
    squares, centres = color_squares(plain, width)
    height = int(tops[-1]) + len(squares)
    if width * height > MAX_PIXELS:
        raise InputError(f"its pictures put together have more than {MAX_PIXELS >> 20} million pixels")
    whole = np.zeros((height, width, 3), np.uint8)
    whole[tops[-1] :] = squares
    for image, top in zip(pictures, tops, strict=False):
        whole[top : top + image.shape[0], : image.shape[1]] = image
    starts = np.cumsum(loop_total) - loop_total
    lowest = np.floor(np.minimum.reduceat(corner_uv, starts, axis=0) + 1e-6)
    within = corner_uv - np.repeat(lowest, loop_total, axis=0)
    number = np.repeat(picture_of, loop_total)
    at = np.repeat(centres + np.array([0, tops[-1]]), loop_total, axis=0)
    for index, image in enumerate(pictures):
        mine = number == index
        size = np.array(image.shape[1::-1])
        here = np.stack([within[mine, 0], 1 - within[mine, 1]], axis=1) * size
        at[mine] = np.clip(here, 0.5, size - 0.5) + np.array([0, tops[index]])
    return whole, at / [width, height] * [1, -1] + [0, 1]


def color_squares(
    colors: Float[np.ndarray, "n 3"], width: int
) -> tuple[UInt8[np.ndarray, "h w 3"], Float[np.ndarray, "n 2"]]:
    """Draw a square of `CELL` pixels for every different colour (sRGB in [0, 1]); locate each colour's square.

    A picture of that width, and the middle (x, y) of the squares in pixels.
    """
    palette, cell = np.unique(to_bytes(colors), axis=0, return_inverse=True)
    across = max(width // CELL, 1)
    at = np.arange(len(palette))
    row, column = at // across * CELL, at % across * CELL
    picture = np.full((CELL * -(-len(palette) // across), max(width, CELL), 3), 255, np.uint8)
    for step in range(CELL * CELL):
        picture[row + step // CELL, column + step % CELL] = palette
    return picture[:, :width], np.stack([column, row], axis=1)[cell.reshape(-1)] + CELL / 2


def to_bytes(colors: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 3"]:
    """Convert colours in [0, 1] to 8-bit sRGB; what lies outside is clipped."""
    return np.rint(np.clip(colors, 0, 1) * 255).astype(np.uint8)
