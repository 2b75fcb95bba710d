# SPDX-License-Identifier: GPL-3.0-or-later
"""What is made from a run to take along: sheets to print, turntables, films. They lie where the run keeps its logs."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..blender.blend_paths import first_free
from ..body.objects import scene_axes
from ..files.writing import write_text
from ..training.runs import side_folder

SHEETS, TURNTABLE, FILM = "print sheets", "turntable", "film"
MADE = (SHEETS, TURNTABLE, FILM)
BESIDE = (".json", ".csv", ".jsonl", ".out", ".log")
"""Suffixes of what lies beside them."""
GIF_FPS = 12.5
"""Frames a second of a GIF: twice as many make it twice as large."""
MOST_KEYS = 120
"""Keyframes that a camera's way is told in."""


def new_place(run: Path, name: str, suffix: str = "") -> Path:
    """A path for something new, such as "turntable 2.gif"."""
    return first_free(side_folder(run), name, suffix)


def made(run: Path) -> list[Path]:
    """What was made from a run, the latest first."""
    found = [path for name in MADE for path in side_folder(run).glob(f"{name}*") if path.suffix not in BESIDE]
    found = [path for path in found if not path.name.endswith("scene")]
    return sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)


def film_fps(scene: bpy.types.Scene, suffix: str) -> float:
    """Frames a second of a film of this scene."""
    fps = scene.render.fps / scene.render.fps_base
    return min(fps, GIF_FPS) if suffix == ".gif" else fps


def write_camera(context: bpy.types.Context, path: Path, pivot: np.ndarray) -> None:
    """The way of the scene's camera around `pivot` (metres, the trainer's axes), over the scene's frames, as keyframes
    for `cloak film`: time, azimuth, elevation, distance. The frame returns at the end."""
    scene = context.scene
    frame, subframe = scene.frame_current, scene.frame_subframe
    step = max(1, -(-(scene.frame_end - scene.frame_start) // MOST_KEYS))
    frames = sorted({*range(scene.frame_start, scene.frame_end + 1, step), scene.frame_end})
    places = []
    try:
        for number in frames:
            scene.frame_set(number)
            place = scene.camera.evaluated_get(context.evaluated_depsgraph_get()).matrix_world.translation
            places.append(scene_axes(np.array(place, float)) * scene.unit_settings.scale_length)
    finally:
        scene.frame_set(frame, subframe=subframe)
    seconds = (np.array(frames) - frames[0]) * scene.render.fps_base / scene.render.fps
    write_text(path, keyframes(seconds, np.array(places) - pivot))


def keyframes(seconds: np.ndarray, away: np.ndarray) -> str:
    """CSV of keyframes from times [n] and the camera's places [n, 3] around what it looks at."""
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-3)
    azimuth = np.degrees(np.unwrap(np.arctan2(away[:, 0], away[:, 2])))
    elevation = np.degrees(np.arcsin(np.clip(away[:, 1] / distance, -1, 1)))
    rows = zip(seconds, azimuth, elevation, distance, strict=True)
    return "time,azimuth,elevation,distance\n" + "".join(",".join(f"{x:.4f}" for x in row) + "\n" for row in rows)
