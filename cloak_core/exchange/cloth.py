"""Cloth on a body: where each point of the surface lies on a flat piece of cloth that repeats."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..files.errors import InputError
from ..files.reading import read_json
from .bodies import Bodies, face_normals

CLOTH_FILE = "cloth.png"
"""Of a run: what to print, a pixel for each square."""


def cloth_metres(folder: Path) -> float:
    """Read how wide a run's cloth is, metres. InputError: its configuration does not say."""
    settings = read_json(folder / "config.json").get("settings")
    centimetres = settings.get("tile_cm") if isinstance(settings, dict) else None
    if not isinstance(centimetres, int | float) or not centimetres > 0:
        raise InputError(f"{folder / 'config.json'}: does not say how wide {CLOTH_FILE} is (settings.tile_cm)")
    return centimetres / 100


def cloth_coordinates(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Map points [N, 3] with normals [N, 3] to metres right and down on the cloth [N, 2], as seen from outside.

    Clothes are cut from flat panels: front and back are projected along z, the sides along x.
    """
    sideways = np.abs(normals[:, 0]) > np.abs(normals[:, 2])
    across = np.where(normals[:, 2] < 0, -points[:, 0], points[:, 0])
    across = np.where(sideways, -points[:, 2] * np.sign(normals[:, 0]), across)
    return np.stack([across, -points[:, 1]], axis=1)


def corner_uv(bodies: Bodies, width: float, height: float) -> np.ndarray:
    """Find the texture coordinates, v up, of the polygons' corners on a cloth of this size in metres; [C, 2] float32.

    As the trainer lays it: in the pose for cloth, each polygon within one panel. The picture repeats beyond [0, 1]. A
    scene that stores no polygons has its triangles' corners instead.
    """
    face, loops = np.repeat(bodies.triangle_face, 3), bodies.triangles.ravel()
    if bodies.loop_total is not None:
        face, loops = np.repeat(np.arange(bodies.face_count), bodies.loop_total), bodies.loop_vertices
    bodies = bodies.for_cloth()
    normals = face_normals(bodies)[face]
    return (cloth_coordinates(bodies.vertices[0][loops], normals) / [width, -height]).astype(np.float32)
