"""Where the camera is at every frame of a take: still, around the body, towards it, or by keyframes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from cloak_core.evaluation.film.settings import MOST_FRAMES, FilmSettings
from cloak_core.files.errors import InputError
from cloak_core.files.tables import number, read_table

KINDS = ("still", "orbit", "approach")
COLUMNS = ("time", "azimuth", "elevation", "distance")
LEAST_SECONDS = 4.0
"""Of a take with a moving camera, where nobody says how long it is."""


@dataclass(frozen=True, eq=False)
class CameraPath:
    """The camera at T frames. Azimuths count from where a take begins."""

    time: Float64[np.ndarray, T]
    """Seconds."""
    azimuth: Float32[np.ndarray, T]
    """Degrees."""
    elevation: Float32[np.ndarray, T]
    """Degrees."""
    distance: Float32[np.ndarray, T]
    """Metres."""

    def __len__(self) -> int:
        return len(self.time)

    @property
    def approaches(self) -> bool:
        """Whether it comes nearer, and never goes back."""
        return bool((np.diff(self.distance) <= 0).all() and self.distance[-1] < self.distance[0])


def camera_path(settings: FilmSettings, poses: int) -> CameraPath:
    """The path that the settings ask for, of a motion with so many poses.

    InputError: a camera of another name, a file of keyframes that is none, too many frames.
    """
    keys = None if settings.camera in KINDS else read_keyframes(Path(settings.camera), settings)
    seconds = settings.seconds or _usual_seconds(settings, poses, keys)
    count = max(1, round(seconds * settings.fps))
    if count * len(settings.angles) > MOST_FRAMES:
        raise InputError(f"--seconds: {count * len(settings.angles):,} frames in all, more than {MOST_FRAMES:,}")
    time = np.arange(count) / settings.fps
    if keys is not None:
        return CameraPath(time, *(_row(np.interp(time, keys["time"], keys[name])) for name in COLUMNS[1:]))
    share = np.arange(count) / count  # a full turn ends where it began, so its last frame is one before
    azimuth = 360 * settings.turns * share if settings.camera == "orbit" else np.zeros(count)
    distance = np.full(count, settings.distance)
    if settings.camera == "approach":
        distance = np.linspace(settings.far, settings.near, count)
    return CameraPath(time, _row(azimuth), _row(np.full(count, settings.elevation)), _row(distance))


def read_keyframes(path: Path, settings: FilmSettings) -> dict[str, np.ndarray]:
    """The columns of a CSV file of keyframes, in the order of time; what is not in it stays as the settings have it."""
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


def _row(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, np.float32)
