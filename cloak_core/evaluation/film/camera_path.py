"""Where the camera is at every frame of a take: still, around the body, towards it, or by keyframes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from cloak_core.evaluation.film.settings import MOST_FRAMES, FilmSettings
from cloak_core.files.errors import InputError
from cloak_core.files.tables import number, read_table

KINDS = ("still", "orbit", "approach")
COLUMNS = ("time", "azimuth", "elevation", "distance")
LEAST_SECONDS = 4.0
"""Length of a take with a moving camera where the settings name none."""


def camera_path(settings: FilmSettings, poses: int) -> pd.DataFrame:
    """Compute the camera of every frame of a take: `COLUMNS` in seconds, degrees, degrees and metres.

    Azimuths count from where the take begins. poses: how many the motion has. InputError: no such camera, a bad file
    of keyframes, too many frames.
    """
    keys = None if settings.camera in KINDS else read_keyframes(Path(settings.camera), settings)
    seconds = settings.seconds or _usual_seconds(settings, poses, keys)
    count = max(1, round(seconds * settings.fps))
    if count * len(settings.angles) > MOST_FRAMES:
        raise InputError(f"--seconds: {count * len(settings.angles):,} frames in all, more than {MOST_FRAMES:,}")
    path = pd.DataFrame({"time": np.arange(count) / settings.fps})
    if keys is not None:
        moving = {name: np.interp(path["time"], keys["time"], keys[name]) for name in COLUMNS[1:]}
    else:
        share = np.arange(count) / count  # a full turn ends where it began, so its last frame is one before
        approaching = np.linspace(settings.far, settings.near, count)
        moving = {
            "azimuth": 360 * settings.turns * share if settings.camera == "orbit" else 0.0,
            "elevation": settings.elevation,
            "distance": approaching if settings.camera == "approach" else settings.distance,
        }
    return path.assign(**moving).astype(dict.fromkeys(COLUMNS[1:], np.float32))


def approaches(path: pd.DataFrame) -> bool:
    """Tell whether the camera comes nearer and never goes back."""
    distance = path["distance"].to_numpy()
    return bool((np.diff(distance) <= 0).all() and distance[-1] < distance[0])


def read_keyframes(path: Path, settings: FilmSettings) -> dict[str, np.ndarray]:
    """Read the keyframes of a CSV file by column, in the order of time; missing columns stay as the settings say."""
    if path.suffix.lower() != ".csv":
        raise InputError(f"--camera: '{path}' is none of {', '.join(KINDS)}, nor a file NAME.csv of keyframes")
    rows = read_table(path, COLUMNS, ["time"])
    stay = {"time": None, "azimuth": 0.0, "elevation": settings.elevation, "distance": settings.distance}
    keys = {name: np.array([number(row, name, path, stay[name]) for row in rows]) for name in COLUMNS}
    if not rows or (np.diff(keys["time"]) <= 0).any() or keys["time"][0] < 0:
        raise InputError(f"{path}: the times of keyframes begin at 0 or later and grow")
    if (keys["distance"] <= 0).any() or (np.abs(keys["elevation"]) > 90).any():
        raise InputError(f"{path}: distances are above 0, elevations within -90 and 90 degrees")
    return keys


def _usual_seconds(settings: FilmSettings, poses: int, keys: dict | None) -> float:
    if keys is not None:
        return max(float(keys["time"][-1]), 1 / settings.fps)
    once = poses / (settings.poses_per_second or settings.fps)
    return once if settings.camera == "still" else max(once, LEAST_SECONDS)
