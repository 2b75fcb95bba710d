"""Pictures on bodies: as outfits, their texture coordinates from another file, their means over faces.

A texture is an outfit (`Bodies.outfit_textures`): renders look it up point by point, and its means over the faces stand
in wherever one colour per face is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Integer, UInt8

from cloak_core.core.geometry import PLACES, sum_by_face
from cloak_core.core.pictures import read_picture
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_BYTES, read_npz
from cloak_core.sources.bodies.meshes.obj import read_obj

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")


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
    return replace(
        bodies,
        face_colors=colors,
        textures=textures,
        outfit_textures=tuple(textures),
        recorded_topology=bodies.topology,
    )


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
    3], the triangles in this mesh's order.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz":
        return with_uv_arrays(bodies, read_npz(path), path)
    if path.suffix.lower() != ".obj":
        raise InputError(f"{path}: texture coordinates are read from .obj and .npz")
    mesh = read_obj(path)
    if mesh.uv is None or mesh.loop_uv is None:
        raise InputError(f"{path}: it has no texture coordinates (UVs)")
    if mesh.poses.shape[1] != bodies.vertex_count:
        raise InputError(f"{path}: {mesh.poses.shape[1]} vertices, but the body has {bodies.vertex_count}")
    coordinate = {
        tuple(sorted(int(v) for v, _ in three)): dict(three)
        for corners in polygon_corners(mesh.loop_total, mesh.loop_vertices, mesh.loop_uv)
        for three in combinations(corners, 3)
    }
    triangle_uv = np.empty((bodies.triangle_count, 3), np.int64)
    for number, triangle in enumerate(bodies.triangles.tolist()):
        found = coordinate.get(tuple(sorted(triangle)))
        if found is None:
            raise InputError(f"{path}: none of its polygons holds the body's triangle {number} {tuple(triangle)}")
        triangle_uv[number] = [found[vertex] for vertex in triangle]
    return replace(bodies, uv=mesh.uv, triangle_uv=triangle_uv, recorded_topology=bodies.topology)


def with_uv_arrays(bodies: Bodies, arrays: dict[str, np.ndarray], path: Path) -> Bodies:
    """Give the bodies texture coordinates `vt` and their triangles `ft`, as SMPL-X files have them."""
    if not {"vt", "ft"} <= arrays.keys():
        raise InputError(f"{path}: it has no texture coordinates (arrays vt and ft)")
    try:
        return replace(bodies, uv=arrays["vt"], triangle_uv=arrays["ft"], recorded_topology=bodies.topology)
    except InputError as error:
        raise InputError(f"{path}: vt, ft: {error}") from None


def polygon_corners(
    loop_total: Integer[np.ndarray, " faces"], loop: Integer[np.ndarray, " c"], loop_uv: Integer[np.ndarray, " c"]
) -> list[list[tuple[int, int]]]:
    """List each polygon's corners as (vertex, texture coordinate)."""
    pairs = list(zip(loop.tolist(), loop_uv.tolist(), strict=True))
    ends = np.cumsum(loop_total).tolist()
    return [pairs[end - count : end] for end, count in zip(ends, loop_total.tolist(), strict=True)]
