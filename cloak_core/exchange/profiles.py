"""Profiles: which colour is photographed where a colour is sent to the printer. `cloak calibrate` makes them."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..files.errors import InputError
from ..files.reading import read_npz
from ..files.writing import write_npz

VERSION = 1
MOST_STEPS = 65
REFINEMENTS = 8
"""Halvings of the step in which a sent colour is searched, from 1/32 of a channel: finer than eight bits."""


@dataclass(frozen=True, eq=False)
class Profile:
    """A table of photographed colours, interpolated (trilinear) between its entries. All are sRGB in [0, 1]."""

    table: np.ndarray
    """[N, N, N, 3] float32: by the red, green and blue that is sent, evenly from 0 to 1."""
    figures: dict[str, float] = field(default_factory=dict)
    """What its making said of it: de2000_before, de2000_after, patches."""

    def photographed(self, sent: np.ndarray) -> np.ndarray:
        """[n, 3] colours as they come out of printer and camera, float32."""
        last = len(self.table) - 1
        place = np.clip(np.asarray(sent, np.float64), 0, 1) * last
        low = np.minimum(place.astype(np.int64), last - 1)
        share = place - low
        seen = np.zeros((len(place), 3))
        for corner in itertools.product((0, 1), repeat=3):
            red, green, blue = np.where(corner, share, 1 - share).T
            seen += (red * green * blue)[:, None] * self.table[tuple((low + corner).T)]
        return seen.astype(np.float32)

    def to_send(self, wanted: np.ndarray) -> np.ndarray:
        """[n, 3] float32: what comes out nearest to the wanted colours; itself where these can be reached."""
        # Colours repeat: a few inks on thousands of faces.
        wanted, which = np.unique(np.asarray(wanted, np.float64), axis=0, return_inverse=True)
        steps = np.linspace(0, 1, 17)
        grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        sent = grid[_nearest(wanted, self.photographed(grid))]
        best = self._miss(sent, wanted)
        around = np.concatenate([list(itertools.product((-1, 1), repeat=3)), np.eye(3), -np.eye(3)])
        for halving in range(2 * REFINEMENTS):
            # Two rounds at each width: the first may stop one step short along a diagonal valley.
            for move in around / 32 / 2 ** (halving // 2):
                tried = np.clip(sent + move, 0, 1)
                miss = self._miss(tried, wanted)
                better = miss < best
                sent[better], best[better] = tried[better], miss[better]
        return sent.astype(np.float32)[which.reshape(-1)]

    def _miss(self, sent: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        return ((self.photographed(sent) - wanted) ** 2).sum(axis=1)


def _nearest(wanted: np.ndarray, among: np.ndarray) -> np.ndarray:
    """The row of `among` that is nearest to each wanted colour."""
    square = (among.astype(np.float64) ** 2).sum(axis=1)
    parts = [wanted[first : first + 256] for first in range(0, len(wanted), 256)]
    nearest = [(square - 2 * part @ among.T).argmin(axis=1) for part in parts]
    return np.concatenate(nearest) if nearest else np.empty(0, np.int64)


def read_profile(path: str | os.PathLike) -> Profile:
    """A profile from its file. InputError: it is none, or damaged."""
    path = Path(path)
    arrays = read_npz(path)
    table, version = arrays.get("table"), arrays.get("version")
    if table is None or version is None or version.shape or version.dtype.kind not in "iu":
        raise InputError(f"{path}: not a profile (`cloak calibrate` makes them)")
    if version > VERSION:
        raise InputError(f"{path}: version {version} is newer than this Cloak reads ({VERSION})")
    steps = len(table) if table.ndim else 0
    if table.shape != (steps, steps, steps, 3) or table.dtype.kind != "f" or not 2 <= steps <= MOST_STEPS:
        raise InputError(f"{path}: a table of colours is float [N, N, N, 3], N from 2 to {MOST_STEPS}")
    if not np.isfinite(table).all() or table.min() < 0 or table.max() > 1:
        raise InputError(f"{path}: colours outside [0, 1]")
    names = ("de2000_before", "de2000_after", "patches")
    figures = {name: float(arrays[name]) for name in names if name in arrays and not arrays[name].shape}
    return Profile(table.astype(np.float32), figures)


def write_profile(path: str | os.PathLike, profile: Profile) -> None:
    """Replace a profile's file (.npz) atomically."""
    figures = {name: np.array(value, np.float64) for name, value in profile.figures.items()}
    write_npz(path, True, version=np.array(VERSION), table=profile.table.astype(np.float32), **figures)
