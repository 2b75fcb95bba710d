"""What a mesh file holds, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

MAX_FILE_BYTES = 1 << 30


@dataclass(frozen=True, eq=False)
class MeshFile:
    """One mesh as its file gives it, in one pose or several (P poses, V vertices, F polygons with C corners in all)."""

    poses: np.ndarray
    """[P, V, 3] float64."""
    loop_total: np.ndarray
    """[F] int: corners of each polygon."""
    loop_vertices: np.ndarray
    """[C] int: vertices of the polygons, one after the other."""
    face_colors: np.ndarray | None = None
    """[F, 3] sRGB in [0, 1]."""
    uv: np.ndarray | None = None
    """[U, 2], v up."""
    loop_uv: np.ndarray | None = None
    """[C] int into `uv`, -1 where a corner has no texture coordinates."""
    pictures: Sequence[np.ndarray] = ()
    """Of the materials, uint8 [H, W, 3], row 0 at the top."""
    picture_of: np.ndarray | None = None
    """[F] int: the picture of each face, -1 where it is plain; None: all are."""

    @property
    def has_uv(self) -> bool:
        """Whether every corner has texture coordinates."""
        return self.uv is not None and bool((self.loop_uv >= 0).all())


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Convert scene-linear colours to display-referred sRGB in [0, 1]; they are clipped."""
    linear = np.clip(np.asarray(linear, np.float64), 0, 1)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


def to_linear(srgb: np.ndarray) -> np.ndarray:
    """Convert display-referred sRGB in [0, 1] to scene-linear colours."""
    srgb = np.asarray(srgb, np.float64)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def mean_of_corners(values: np.ndarray, loop_total: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """Average per-vertex values [V, ...] over each polygon's corners [F, ...]."""
    starts = np.cumsum(loop_total) - loop_total
    return np.add.reduceat(values[loop], starts, axis=0) / loop_total.reshape(-1, *[1] * (values.ndim - 1))


def file_beside(path: Path, name: str) -> Path | None:
    """Find a file that another one names, if it lies in that one's folder or below; else None."""
    folder = path.resolve().parent
    try:
        beside = (folder / name.replace("\\", "/")).resolve()
        return beside if beside.is_relative_to(folder) and beside.is_file() else None
    except (OSError, ValueError):
        return None
