"""Pictures on bodies: as outfits, several as one, their texture coordinates from another file, their means over faces.

A texture is an outfit (`Bodies.outfit_textures`): renders look it up point by point, and its means over the faces stand
in wherever one colour per face is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Integer, UInt8

from cloak_core.core.geometry import PLACES, sum_by_face
from cloak_core.core.pictures import MAX_PIXELS, read_picture
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_BYTES, read_npz
from cloak_core.sources.bodies.meshes.mesh_file import MeshFile
from cloak_core.sources.bodies.meshes.obj import read_obj

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
CELL = 4
"""Side in pixels of a plain colour's square in a picture put together from several."""


def read_textures(paths: Sequence[str | Path]) -> dict[str, UInt8[np.ndarray, "h w 3"]]:
    """Read pictures by name (the files' stems), from files and from folders of them. InputError."""
    files: list[Path] = []
    for path in map(Path, paths):
        inside = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
        if not inside:
            raise InputError(f"{path}: no {', '.join(s[1:] for s in SUFFIXES)} in it")
        files += inside
    textures: dict[str, np.ndarray] = {}
    for file in files:
        name = file.stem if file.stem not in textures else f"{file.stem} {len(textures)}"
        textures[name] = read_picture(file)
        if sum(image.nbytes for image in textures.values()) > MAX_BYTES:
            raise InputError(f"{file}: these textures need more than {MAX_BYTES >> 30} GiB")
    return textures


def dress_in_textures(bodies: Bodies, textures: dict[str, UInt8[np.ndarray, "h w 3"]]) -> Bodies:
    """Dress the bodies in one outfit per texture, instead of the outfits they had."""
    if bodies.uv is None:
        name = next(iter(textures))
        raise InputError(f"texture '{name}': scene '{bodies.name}' has no texture coordinates (UVs) to put it on")
    colors = np.stack([texture_means(bodies, image) for image in textures.values()])
    outfits = {"face_colors": colors, "textures": textures, "outfit_textures": tuple(textures)}
    return replace(bodies, **outfits, recorded_topology=bodies.topology)


def texture_means(bodies: Bodies, image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "faces 3"]:
    """Average a picture over each face, sRGB in [0, 1], from four points of each of its triangles."""
    assert bodies.uv is not None and bodies.triangle_uv is not None
    places = np.einsum("pk,tkc->tpc", PLACES, bodies.uv[bodies.triangle_uv].astype(np.float64)) % 1
    height, width = image.shape[:2]
    column = np.minimum((places[..., 0] * width).astype(np.int64), width - 1)
    row = np.minimum(((1 - places[..., 1]) * height).astype(np.int64), height - 1)
    colors = image[row, column].mean(axis=1) / 255
    count = np.bincount(bodies.triangle_face, minlength=bodies.face_count)
    return (sum_by_face(bodies, colors) / np.maximum(count, 1)[:, None]).astype(np.float32)


def with_uv_of(bodies: Bodies, path: str | Path) -> Bodies:
    """Give the bodies the texture coordinates of a file.

    An OBJ with the same vertices and polygons, whatever their order and cut, or an .npz with `vt` [U, 2] and `ft` [T,
    3], the triangles in this mesh's order, as SMPL-X files have them.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz":
        arrays = read_npz(path)
        if not {"vt", "ft"} <= arrays.keys():
            raise InputError(f"{path}: it has no texture coordinates (arrays vt and ft)")
        uv, triangle_uv = arrays["vt"], arrays["ft"]
    elif path.suffix.lower() == ".obj":
        uv, triangle_uv = _uv_of_obj(bodies, path)
    else:
        raise InputError(f"{path}: texture coordinates are read from .obj and .npz")
    try:
        return replace(bodies, uv=uv, triangle_uv=triangle_uv, recorded_topology=bodies.topology)
    except InputError as error:
        raise InputError(f"{path}: vt, ft: {error}") from None


def _uv_of_obj(bodies: Bodies, path: Path) -> tuple[np.ndarray, np.ndarray]:
    mesh = read_obj(path)
    if not mesh.has_uv:
        raise InputError(f"{path}: it has no texture coordinates (UVs)")
    if mesh.poses.shape[1] != bodies.vertex_count:
        raise InputError(f"{path}: {mesh.poses.shape[1]} vertices, but the body has {bodies.vertex_count}")
    corners = list(zip(mesh.loop_vertices.tolist(), mesh.loop_uv.tolist(), strict=True))
    ends = np.cumsum(mesh.loop_total).tolist()
    # A triangle of the body is found by its three vertices, whichever way the file's polygon would be cut.
    coordinate = {
        tuple(sorted(vertex for vertex, _ in three)): dict(three)
        for end, count in zip(ends, mesh.loop_total.tolist(), strict=True)
        for three in combinations(corners[end - count : end], 3)
    }
    triangle_uv = np.empty((bodies.triangle_count, 3), np.int64)
    for number, triangle in enumerate(bodies.triangles.tolist()):
        uv_of_vertex = coordinate.get(tuple(sorted(triangle)))
        if uv_of_vertex is None:
            raise InputError(f"{path}: none of its polygons holds the body's triangle {number} {tuple(triangle)}")
        triangle_uv[number] = [uv_of_vertex[vertex] for vertex in triangle]
    return mesh.uv, triangle_uv


def one_picture(mesh: MeshFile) -> MeshFile:
    """Give a mesh one picture: the only one of all faces, or all of them and the plain colours put together.

    InputError: a face that has a picture, but no texture coordinates; all pictures together are too large.
    """
    used = [] if mesh.picture_of is None else np.unique(mesh.picture_of)
    if not len(used) or used[-1] < 0:
        return replace(mesh, pictures=())
    uv = np.zeros((0, 2)) if mesh.uv is None else mesh.uv
    corner_uv = np.concatenate([uv, [[np.nan, np.nan]]])[mesh.loop_uv]
    has_picture = np.repeat(mesh.picture_of, mesh.loop_total) >= 0
    missing = np.flatnonzero(has_picture & ~np.isfinite(corner_uv).all(axis=1))
    if len(missing):
        face = int(np.searchsorted(np.cumsum(mesh.loop_total), missing[0], side="right"))
        raise InputError(f"face {face} has a texture but no texture coordinates (UVs)")
    if len(used) == 1:
        return replace(mesh, pictures=(mesh.pictures[used[0]],))
    placed = mesh.face_colors, np.nan_to_num(corner_uv), mesh.loop_total
    picture, corner_uv = put_together(mesh.pictures, mesh.picture_of, *placed)
    return replace(mesh, pictures=(picture,), uv=corner_uv, loop_uv=np.arange(len(corner_uv)))


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
        is_inside = number == index
        size = np.array(image.shape[1::-1])
        here = np.stack([within[is_inside, 0], 1 - within[is_inside, 1]], axis=1) * size
        at[is_inside] = np.clip(here, 0.5, size - 0.5) + np.array([0, tops[index]])
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
