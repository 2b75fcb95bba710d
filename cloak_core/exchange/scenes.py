"""Scene packages: bodies as a folder, or as one .npz with the same arrays."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..files.errors import InputError
from ..files.reading import read_json, read_npz
from ..files.writing import new_folder, require_new, write_json, write_npz
from .bodies import Bodies
from .checks import FORMAT_VERSION, check_version, frozen

AXES = "y up, facing +z, right-handed"
OPTIONAL = ("triangle_face", "face_colors", "loop_total", "loop_vertices", "uv", "triangle_uv", "laid_out")


def read_scene(path: str | os.PathLike) -> Bodies:
    """Bodies from a scene package (a folder with scene.json and bodies.npz) or from one .npz with the same arrays."""
    path = Path(path)
    record: dict = {}
    arrays_path = path
    if path.is_dir():
        if not (path / "scene.json").exists():
            raise InputError(f"{path}: not a scene (no scene.json in it)")
        record, arrays_path = read_json(path / "scene.json"), path / "bodies.npz"
        check_version(record, "cloak scene", path / "scene.json")
    elif not path.exists():
        raise InputError(f"{path}: no such scene")
    elif path.suffix.lower() != ".npz":
        raise InputError(f"{path}: not a scene (a folder with scene.json, or an .npz; cloak scene import reads meshes)")
    arrays = {key: frozen(array) for key, array in read_npz(arrays_path).items()}
    for key in ("vertices", "triangles"):
        if key not in arrays:
            raise InputError(f"{arrays_path}: not a scene (no array '{key}')")
    topology = record.get("topology")
    named = lambda prefix: {k[len(prefix) :]: v for k, v in arrays.items() if k.startswith(prefix)}
    try:
        bodies = Bodies(
            vertices=arrays["vertices"],
            triangles=arrays["triangles"],
            **{key: arrays.get(key) for key in OPTIONAL},
            regions=named("region_"),
            textures=named("texture_"),
            outfit_textures=tuple(str(n) for n in arrays.get("outfit_textures", ())),
            names=tuple(str(n) for n in arrays.get("names", ())),
            name=str(record.get("name", path.stem)),
            recorded_topology=topology if isinstance(topology, str) else None,
        )
    except InputError as error:
        raise InputError(f"{arrays_path}: {error}") from None
    if record.get("topology", bodies.topology) != bodies.topology:
        raise InputError(f"{path}: scene.json records topology {topology}, bodies.npz holds {bodies.topology}")
    return bodies


def write_scene(folder: str | os.PathLike, bodies: Bodies, creator: str = "cloak") -> Path:
    """Write a scene package; the folder must not exist yet (or be empty). It appears whole or not at all."""
    folder = Path(folder)
    require_new(folder)
    arrays = {key: getattr(bodies, key) for key in ("vertices", "triangles", *OPTIONAL)}
    arrays = {key: array for key, array in arrays.items() if array is not None}
    arrays |= {f"region_{k}": v for k, v in bodies.regions.items()}
    arrays |= {f"texture_{k}": v for k, v in bodies.textures.items()}
    if bodies.outfit_textures:
        arrays["outfit_textures"] = np.array(bodies.outfit_textures, np.str_)
    record = {
        "format": "cloak scene",
        "version": FORMAT_VERSION,
        "name": bodies.name,
        "axes": AXES,
        "unit": "metre",
        "poses": bodies.pose_count,
        "vertices": bodies.vertex_count,
        "triangles": bodies.triangle_count,
        "faces": bodies.face_count,
        "outfits": bodies.outfit_count,
        "topology": bodies.topology,
        "creator": creator,
    }
    with new_folder(folder) as temporary:
        write_npz(temporary / "bodies.npz", names=np.array(bodies.names, np.str_), **arrays)
        write_json(temporary / "scene.json", record)
    return folder
