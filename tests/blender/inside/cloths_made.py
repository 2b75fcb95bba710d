"""Cloths that repeat, as runs of them lie in a folder, and what they should look like."""

import json
from pathlib import Path

import bpy
import numpy as np
from cloak.blender import pictures
from made import made_run

SQUARES, METRES = 8, 0.4


def save_picture(path: Path, squares: np.ndarray) -> None:
    """A PNG of squares [h, w, 3], the first row at the top."""
    pictures.save_picture(path, squares[::-1])


def cloth_run(folder: Path, obj: bpy.types.Object, ids: np.ndarray, squares: np.ndarray) -> Path:
    """A run of a cloth on faces of an object, whose own colours are grey."""
    run = made_run(folder, obj, ids, np.full((len(ids), 3), 0.5, np.float32))
    save_picture(run / "cloth.png", squares)
    (run / "config.json").write_text(json.dumps({"format": "cloak run", "settings": {"tile_cm": 100 * METRES}}))
    return run


def random_squares(seed: int = 0) -> np.ndarray:
    return np.round(255 * np.random.default_rng(seed).random((SQUARES, SQUARES, 3))).astype(np.float32) / 255


def wall(size: float = 2.0) -> bpy.types.Object:
    """A wall of few large faces that faces the front, about the origin."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=3, y_subdivisions=3, size=size, rotation=(np.pi / 2, 0, 0))
    bpy.context.view_layer.update()
    return bpy.context.object


def wanted_at(x: np.ndarray, z: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """What the trainer sees at places of a front panel: `Grid.square_at`, metres right and down."""
    row, column = np.floor(-z / METRES * SQUARES).astype(int), np.floor(x / METRES * SQUARES).astype(int)
    return squares[row % SQUARES, column % SQUARES]


def seen_pixels(path: Path) -> np.ndarray:
    return pictures.read_picture(path)[..., :3]
