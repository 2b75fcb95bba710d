"""Meshes from files, one pose per file, as one scene: OBJ and PLY with their polygons, glTF, Cloak's own .npz, and
whatever Blender reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cloak_core.core.polygons import triangulate
from cloak_core.exchange.bodies import Bodies, topology_hash
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.errors import InputError
from cloak_core.files.reading import open_regular
from cloak_core.sources.bodies.blender.outside import SUFFIXES, read_through_blender
from cloak_core.sources.bodies.meshes.gltf import read_gltf
from cloak_core.sources.bodies.meshes.mesh_file import MAX_FILE_BYTES, MeshFile
from cloak_core.sources.bodies.meshes.obj import read_obj
from cloak_core.sources.bodies.meshes.ply import read_ply
from cloak_core.sources.bodies.meshes.textures import dress_in_textures, one_picture

READERS = {".obj": read_obj, ".ply": read_ply, ".glb": read_gltf, ".gltf": read_gltf}
READERS |= dict.fromkeys(SUFFIXES, read_through_blender)
ANIMATED = (".glb", ".gltf", *SUFFIXES)
HEIGHTS = (0.1, 20.0)
"""Heights in metres that a person's body may have; outside, the file's unit is something else."""


def import_bodies(
    paths: Sequence[str | Path], name: str = "scene", scale: float | None = None, frames: int = 0
) -> Bodies:
    """Import bodies from mesh files of one topology, a pose per file (all its poses, of a .npz).

    Files are in metres, y up, facing +z (Blender's OBJ default); `scale` multiplies coordinates, and given one,
    heights are not questioned. Of animated files `frames` moments are taken (0: the resting pose). Polygons are
    triangulated once, in the first file's pose. Colours, texture coordinates and regions are the first file's.

    Raises `InputError`, with the file's name, for anything that cannot be read, for NaN, for a topology that differs
    from the first file's, and for bodies lower than 10 cm or higher than 20 m.
    """
    paths = [Path(path) for path in paths]
    if not paths:
        raise InputError("no mesh file to import")
    if scale is not None and not 0 < scale < np.inf:
        raise InputError(f"scale {scale}: a positive number is needed")
    first = None
    poses, names = [], []
    again: Counter[str] = Counter()
    for path in paths:
        bodies = read_bodies(path, first, frames)
        first = first or bodies
        if bodies.topology != first.topology:
            raise InputError(f"{path}: topology {bodies.topology} differs from {paths[0]}'s {first.topology}")
        if scale is None:
            check_heights(path, bodies.vertices)
        poses.append(bodies.vertices if scale is None else bodies.vertices * np.float32(scale))
        for own in bodies.names:  # those that come again have a number behind them
            again[own] += 1
            names.append(own if again[own] == 1 else f"{own} {again[own]}")
    vertices = np.concatenate(poses)
    return replace(first, vertices=vertices, names=tuple(names), name=name, recorded_topology=first.topology)


def read_bodies(path: Path, first: Bodies | None = None, frames: int = 0) -> Bodies:
    """Read one file; `first` is the scene's first file, whose triangles are kept where polygons are the same."""
    suffix = path.suffix.lower()
    if suffix == ".npz" or path.is_dir():
        return read_scene(path)
    if suffix not in READERS:
        raise InputError(f"{path}: not a mesh that is read here ({', '.join([*READERS, '.npz'])})")
    with open_regular(path, MAX_FILE_BYTES) as file:
        if not file.read(1):
            raise InputError(f"{path}: the file is empty")
    mesh = READERS[suffix](path, frames) if suffix in ANIMATED else READERS[suffix](path)
    check_mesh(path, mesh)
    try:
        return bodies_of(mesh, path.stem, first)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def check_mesh(path: Path, mesh: MeshFile) -> None:
    if not len(mesh.loop_total):
        raise InputError(f"{path}: no faces in it")
    bad = np.flatnonzero(~np.isfinite(mesh.poses).all(axis=(0, 2)))
    if len(bad):
        raise InputError(f"{path}: vertex {bad[0]} is not finite ({len(bad)} such)")
    count = mesh.poses.shape[1]
    beyond = np.flatnonzero((mesh.loop_vertices < 0) | (mesh.loop_vertices >= count))
    if len(beyond):
        face = int(np.searchsorted(np.cumsum(mesh.loop_total), beyond[0], side="right"))
        raise InputError(f"{path}: face {face} names vertex {mesh.loop_vertices[beyond[0]]}, beyond {count}")


def bodies_of(mesh: MeshFile, name: str, first: Bodies | None) -> Bodies:
    """Make bodies of a mesh."""
    topology = topology_hash(mesh.poses.shape[1], mesh.loop_total, mesh.loop_vertices)
    mapped = {}
    pictures = ()
    if first is not None and first.topology == topology:
        # Another pose of the same polygons: they keep the triangles of the first pose.
        triangles, triangle_face = first.triangles, first.triangle_face
    else:
        corners, triangle_face = triangulate(mesh.poses[0], mesh.loop_total, mesh.loop_vertices)
        triangles = mesh.loop_vertices[corners]
        mesh = one_picture(mesh)
        pictures = mesh.pictures
        if mesh.has_uv:
            mapped = {"uv": mesh.uv, "triangle_uv": mesh.loop_uv[corners]}
    bodies = Bodies(
        vertices=mesh.poses.astype(np.float32),
        triangles=triangles,
        triangle_face=triangle_face,
        face_colors=None if mesh.face_colors is None else mesh.face_colors[None].astype(np.float32),
        names=(name,) if len(mesh.poses) == 1 else tuple(f"{name} {i:03}" for i in range(len(mesh.poses))),
        loop_total=mesh.loop_total,
        loop_vertices=mesh.loop_vertices,
        name=name,
        **mapped,
    )
    return dress_in_textures(bodies, {name: pictures[0]}) if pictures else bodies


def check_heights(path: Path, vertices: np.ndarray) -> None:
    low, high = HEIGHTS
    for height in np.ptp(vertices[..., 1], axis=1):
        if low <= height <= high:
            continue
        guess = 0.01 if height > high else 100
        raise InputError(
            f"{path}: {height:.3g} m from foot to head, so its unit is not the metre or y is not up"
            f" (scale {guess} would make it {height * guess:.3g} m)"
        )
