"""Files of colours: one for each face of a logo."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..files.errors import InputError
from ..files.reading import read_npy
from ..files.writing import write_npy


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
