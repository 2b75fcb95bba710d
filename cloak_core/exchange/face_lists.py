"""Face lists: which polygons, or triangles, a logo consists of, and which a heat map points at; and their colours."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files.errors import InputError
from ..files.reading import read_json, read_npy
from ..files.writing import write_json, write_npy
from .bodies import Bodies
from .checks import FORMAT_VERSION, check_version


@dataclass(frozen=True, eq=False)
class FaceList:
    """A set of faces as stored in a file."""

    ids: np.ndarray
    """[L] int64, sorted, unique."""
    index_of: str = "polygon"
    """What an id counts: "polygon" (Blender's faces) or "triangle" (the reference project's lists)."""
    topology: str | None = None
    """Hash of the mesh the list was made for, where its sidecar tells."""


def read_face_list(path: str | os.PathLike, bodies: Bodies | None = None) -> FaceList:
    """Read a face list and its sidecar NAME.json; with `bodies`, check it against that mesh.

    Any integer type and order is read. Refused, by name: duplicates, negatives, floats, ids beyond the mesh, a sidecar
    for another topology (both hashes). Without a sidecar a .npy list counts polygons; an .idx list, the reference
    project's, counts triangles.
    """
    path = Path(path)
    array = read_npy(path)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise InputError(f"{path}: a face list is one row of integers, not {array.dtype} of shape {array.shape}")
    if not array.size:
        raise InputError(f"{path}: the face list is empty")
    if array.max() > np.iinfo(np.int32).max:
        raise InputError(f"{path}: face id {array.max()} is beyond any mesh")
    ids, counts = np.unique(array.astype(np.int64), return_counts=True)
    if ids[0] < 0:
        raise InputError(f"{path}: negative face id {ids[0]}")
    if counts.max() > 1:
        raise InputError(f"{path}: duplicate face id {ids[counts.argmax()]} ({counts.max()} times)")
    index_of, topology = "triangle" if path.suffix == ".idx" else "polygon", None
    sidecar = path.with_suffix(".json")
    if sidecar.exists() or sidecar.is_symlink():
        record = read_json(sidecar)
        check_version(record, "cloak face list", sidecar)
        index_of, topology = record.get("index_of", index_of), record.get("topology")
        if index_of not in ("polygon", "triangle"):
            raise InputError(f"{sidecar}: index_of is {index_of!r}, neither 'polygon' nor 'triangle'")
    if bodies is not None:
        if topology not in (None, bodies.topology):
            raise InputError(f"{path}: made for topology {topology}, but scene '{bodies.name}' has {bodies.topology}")
        count = bodies.face_count if index_of == "polygon" else bodies.triangle_count
        if ids[-1] >= count:
            raise InputError(f"{path}: {index_of} id {ids[-1]} is beyond the mesh's {count}")
    return FaceList(ids, index_of, topology)


def face_ids(face_list: FaceList, bodies: Bodies) -> np.ndarray:
    """[L] int64 sorted polygon ids of a face list; a polygon belongs as soon as one of its triangles is listed."""
    if face_list.index_of == "polygon":
        return face_list.ids
    return np.unique(bodies.triangle_face[face_list.ids]).astype(np.int64)


def write_face_list(path: str | os.PathLike, ids: np.ndarray, topology: str) -> Path:
    """Write a list of polygons (one-dimensional int64, sorted, unique) and its sidecar NAME.json, each atomically."""
    path = Path(path)
    ids = np.asarray(ids)
    if ids.ndim != 1 or ids.dtype.kind not in "iu":
        raise InputError(f"{path}: a face list is one row of integers, not {ids.dtype} of shape {ids.shape}")
    if not ids.size:
        raise InputError(f"{path}: the face list would be empty")
    ids = np.unique(ids.astype(np.int64))
    record = {
        "format": "cloak face list",
        "version": FORMAT_VERSION,
        "topology": topology,
        "index_of": "polygon",
        "count": len(ids),
    }
    write_json(path.with_suffix(".json"), record)
    write_npy(path, ids)
    return path


def hottest_faces(heat: np.ndarray, areas: np.ndarray, share: float) -> np.ndarray:
    """[L] int64 sorted ids of the faces with the most heat per area that make up `share` of the area of all.

    Heat [F] is not negative, areas [F] are in any unit. Per area, because a large face gathers gradient from more
    pixels: what counts is the gain of each square metre. Faces without heat are never taken, so there may be less area
    than was asked for. InputError: a share outside (0, 1], a heat map of another body, no heat at all.
    """
    if not 0 < share <= 1:
        raise InputError(f"a share of {share} of the area: one in (0, 1] is needed")
    if len(heat) != len(areas):
        raise InputError(f"a heat map of {len(heat)} faces for a body of {len(areas)}")
    heat, areas = np.asarray(heat, np.float64), np.asarray(areas, np.float64)
    density = np.divide(heat, areas, out=np.zeros(len(heat)), where=areas > 0)
    order = np.argsort(-density, kind="stable")
    order = order[density[order] > 0]
    if not len(order):
        raise InputError("the heat map is zero everywhere: no face moves the detector's score")
    # The last face that still fits by half: the area taken is the nearest to what was asked.
    taken = np.searchsorted(np.cumsum(areas[order]) - areas[order] / 2, share * areas.sum())
    return np.sort(order[: max(1, taken)]).astype(np.int64)


def read_colors(path: str | os.PathLike, count: int | None = None) -> np.ndarray:
    """[L, 3] float32 sRGB in [0, 1]; `count` is the number of faces they must be for."""
    path = Path(path)
    colors = read_npy(path)
    if colors.ndim != 2 or colors.shape[1] != 3 or colors.dtype.kind != "f":
        raise InputError(f"{path}: colours are float [faces, 3], not {colors.dtype} of shape {colors.shape}")
    if count is not None and len(colors) != count:
        raise InputError(f"{path}: colours for {len(colors)} faces, but the logo has {count}")
    if not np.isfinite(colors).all() or (colors.size and (colors.min() < 0 or colors.max() > 1)):
        raise InputError(f"{path}: colours outside [0, 1]")
    return colors.astype(np.float32)


def write_colors(path: str | os.PathLike, colors: np.ndarray) -> None:
    """Replace the file of colours [L, 3] atomically: a reader sees the old ones or the new ones."""
    write_npy(path, np.asarray(colors, np.float32))
