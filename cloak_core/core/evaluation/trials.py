"""Which images an evaluation looks at: a table with one row per image, drawn by the seed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from cloak_core.core.evaluation.settings import EvaluateSettings

COLUMNS = ("pose", "angle", "elevation", "distance", "background", "shift_x", "shift_y", "outfit")
"""Pose, background and outfit are indices; azimuth and elevation in degrees, distance in metres, shifts in pixels right
and down. A view that has no such value (a photograph has no azimuth) holds nan, or -1 for an index. Sources of views
may add columns of their own, such as the photograph and the person."""
Column = np.ndarray | Sequence | float | int
"""The values of a column, or one that holds for every image."""
_ABSENT = {"pose": -1, "background": -1, "outfit": -1, "shift_x": 0, "shift_y": 0}


def draw_trials(
    poses: int, angles: Sequence[float], backgrounds: int, outfits: int, settings: EvaluateSettings
) -> pd.DataFrame:
    """Draw the images of an evaluation: every pose, angle, elevation and distance, several times.

    angles: azimuths in degrees. Background, shift and outfit are drawn by the seed; backgrounds are dealt like cards
    from a shuffled deck, so that all come about equally often. Where `settings.most_images` is set, that many of the
    images are drawn by the seed. Returns `COLUMNS`, one row per image.
    """
    rng = np.random.default_rng([settings.seed, 0xE7A1])
    places = (angles, settings.elevations or (settings.elevation,), settings.distances)
    axes = (np.arange(poses), *(np.asarray(values, np.float32) for values in places))
    grid = np.meshgrid(*axes, np.arange(settings.images_per_view), indexing="ij")
    kept = np.arange(grid[0].size)
    if settings.most_images is not None:
        order = np.random.default_rng([settings.seed, 0x3057]).permutation(len(kept))
        kept = np.sort(order[: settings.most_images])
    pose, angle, elevation, distance = (axis.ravel()[kept] for axis in grid[:4])
    count = len(pose)
    decks = [rng.permutation(backgrounds) for _ in range(-(-count // backgrounds))]
    background = np.concatenate(decks)[:count]
    shift = rng.integers(-settings.shift, settings.shift + 1, (count, 2))
    outfit = rng.integers(0, outfits, count)
    return make_trials(pose, angle, elevation, distance, background, shift, outfit)


def make_trials(
    pose: Column,
    angle: Column,
    elevation: Column,
    distance: Column,
    background: Column,
    shift: Column,
    outfit: Column = 0,
) -> pd.DataFrame:
    """Make the table of trials from its columns [N] and the shifts [N, 2]; single values hold for every image."""
    table = pd.DataFrame({"pose": np.asarray(pose, np.int64), "angle": np.asarray(angle, np.float32)})
    table["elevation"], table["distance"] = np.float32(elevation), np.float32(distance)
    table["background"] = np.asarray(background, np.int64)
    table["shift_x"], table["shift_y"] = np.asarray(shift, np.int64).reshape(-1, 2).T
    table["outfit"] = np.int64(outfit)
    return table


def complete(trials: pd.DataFrame) -> pd.DataFrame:
    """Add the columns of `COLUMNS` that a table of trials lacks, as absent, and put them first."""
    absent = {name: _ABSENT.get(name, np.float32(np.nan)) for name in COLUMNS if name not in trials}
    more = [name for name in trials if name not in COLUMNS]
    return trials.assign(**absent)[[*COLUMNS, *more]]
