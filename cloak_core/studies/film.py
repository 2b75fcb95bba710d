"""Make a film from beginning to end: what the camera sees, what detectors report, the figures and the file."""

from __future__ import annotations

import itertools
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float32

from cloak_core.core.cameras import Camera
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluate import Patterns
from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.core.evaluation.measure import OnProgress, check_asked, kept_frozen, measure
from cloak_core.core.evaluation.settings import MOST_FRAMES, FilmSettings
from cloak_core.core.evaluation.trials import make_trials
from cloak_core.core.images import ImageSet
from cloak_core.core.pattern import Pattern
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.records import number, read_table
from cloak_core.files.writing import write_json
from cloak_core.patterns.controls import OwnClothing
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.videos import check_film, save_film, save_gif
from cloak_core.studies.film_frames import draw_frames
from cloak_core.studies.imagery import body_images
from cloak_core.studies.statistics_film import frame_rows, summarize_film

VIEW_BYTES = 1 << 30
"""Memory for views between measuring a film and drawing it."""
TURNTABLE_FRAMES, LEAST_FRAMES = 24, 8
TURNTABLE_FPS = 8.0
TURNTABLE_SHARE = 8
"""A turntable has at most one image for every eight of the evaluation."""
TURNTABLE_SIDE = 256
"""Most pixels along a turntable picture's side."""
STEP = 0.12
"""Metres that a body's vertices move in the mean from one frame of a motion to the next, at most: 3 m/s at 25 frames a
second. Single poses, standing and walking, are further apart."""
HELD_SECONDS = 1.0


def usual_pace(vertices: Float32[np.ndarray, "P V 3"], fps: float) -> float:
    """Choose the poses a second of a film: one a frame of a motion; single poses are held for a second each."""
    around = vertices - vertices.mean(axis=1, keepdims=True)  # wherever the body as a whole goes
    steps = [float(np.linalg.norm(b - a, axis=1).mean()) for a, b in itertools.pairwise(around)]
    return fps if not steps or float(np.median(steps)) <= STEP else 1 / HELD_SECONDS


def make_film(
    pattern: Pattern,
    bodies: Bodies,
    backgrounds: Backgrounds,
    detectors: dict[str, Detector],
    out: Path,
    settings: FilmSettings | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Film the bodies' poses in their order, cloaked and in own clothing; write `out` and its figures beside it.

    out: NAME.mp4, NAME.gif, or a folder of PNGs; NAME.json (or film.json in the folder) takes the figures of every
    frame. Returns contract C7's figures (see `summarize_film`) with `out` and `numbers`, where those are.
    InputError: as for `evaluate`, and what `camera_path` and `save_film` refuse.
    """
    settings = settings or FilmSettings()
    if settings.poses_per_second is None:
        settings = replace(settings, poses_per_second=usual_pace(bodies.vertices, settings.fps))
    kind = check_film(out)
    check_asked(detectors, settings.angles)
    path = camera_path(settings, bodies.pose_count)
    patterns = {LOGO: pattern, CLOTHING: OwnClothing(pattern.cover)}
    images = film_images(bodies, backgrounds, path, settings, patterns, next(iter(detectors.values())).device)
    with kept_frozen(detectors) as hashes:
        results = measure(images, patterns, detectors, batch=settings.batch, on_progress=on_progress)
    summary = summarize_film(results, settings, approaches(path)) | {"cover": pattern.cover.name, "out": str(out)}
    save_film(out, draw_frames(images, patterns, results, settings), settings.fps)
    numbers = out / "film.json" if kind == "folder" else out.with_suffix(".json")
    inputs = {"scene": bodies.name, "topology": bodies.topology, "detector_hashes": hashes}
    plain = asdict(settings) | {"angles": list(settings.angles)}
    rows = frame_rows(results, settings.threshold)
    write_json(numbers, summary | {"settings": plain, "inputs": inputs, "by_frame": rows})
    return summary | {"numbers": str(numbers)}


def film_images(
    bodies: Bodies,
    backgrounds: Backgrounds,
    path: pd.DataFrame,
    settings: FilmSettings,
    patterns: Patterns,
    device: torch.device | str = "cpu",
) -> ImageSet:
    """Make the images of all takes' frames; the camera looks at the motion's middle, or follows each pose."""
    if settings.outfit >= bodies.outfit_count:
        raise InputError(f"--outfit: there is no outfit {settings.outfit}, the scene has {bodies.outfit_count}")
    trials = film_trials(path, settings, bodies.pose_count, len(backgrounds), bodies.outfit_count)
    viewpoint = Camera(field_of_view=settings.field_of_view, width=settings.size, height=settings.size)
    if not settings.follow:
        middles = (bodies.vertices.min(1).astype(np.float64) + bodies.vertices.max(1)) / 2
        viewpoint = replace(viewpoint, pivot=tuple(middles.mean(0).tolist()))
    # Nothing else can use a film's views, so none is written to files.
    render = RenderSettings.of(settings, device=device, memory_bytes=VIEW_BYTES)
    return body_images(bodies, backgrounds, trials, render, viewpoint, patterns.values())


def film_trials(path: pd.DataFrame, settings: FilmSettings, poses: int, backgrounds: int, outfits: int) -> pd.DataFrame:
    """Make the table of trials of all takes: `trials.COLUMNS`, and `take` (from 0) and `time` (seconds in the take).

    The poses follow one another, again and again; every take has the next background and the next outfit.
    """
    take = np.repeat(np.arange(len(settings.angles)), len(path))
    shown = pd.concat([path] * len(settings.angles), ignore_index=True)
    time, angle, elevation, distance = (shown[name].to_numpy() for name in COLUMNS)
    pose = np.floor(time * (settings.poses_per_second or settings.fps) + 1e-6).astype(np.int64) % poses
    angle = angle + np.asarray(settings.angles, np.float32)[take]
    outfit = (settings.outfit + take) % outfits
    still = np.zeros((len(take), 2), np.int64)
    trials = make_trials(pose, angle, elevation, distance, take % backgrounds, still, outfit)
    return trials.assign(take=take, time=time)


def write_turntable(
    path: Path,
    images: ImageSet,
    patterns: Patterns,
    trial: int,
    detectors: dict[str, Detector],
    threshold: float,
) -> bool:
    """Write a GIF of one trial's body turning, in own clothing and cloaked, with what every detector reports.

    images: of bodies; patterns: all that the evaluation looked at. Returns whether there is one: a small evaluation
    would spend more on it than on itself.
    """
    frames = min(TURNTABLE_FRAMES, len(images.trials) * len(patterns) // (2 * TURNTABLE_SHARE))
    if frames < LEAST_FRAMES:
        return False
    view, shown = images.source.viewpoint, images.trials.iloc[trial]
    settings = FilmSettings(
        camera="orbit",
        elevation=float(view.elevation),
        distance=float(shown["distance"]),
        field_of_view=float(view.field_of_view),
        size=min(TURNTABLE_SIDE, view.width),
        fps=TURNTABLE_FPS,
        seconds=frames / TURNTABLE_FPS,
        outfit=int(shown["outfit"]),
        threshold=threshold,
    )
    body = images.source.bodies.select_poses([int(shown["pose"])])
    backgrounds = images.backgrounds.subset([int(shown["background"])])
    patterns = {name: patterns[name] for name in (LOGO, CLOTHING)}
    turning = film_images(body, backgrounds, camera_path(settings, 1), settings, patterns, images.device)
    results = measure(turning, patterns, detectors, batch=settings.batch)
    save_gif(path, list(draw_frames(turning, patterns, results, settings)), TURNTABLE_FPS)
    return True


# --- the camera's path

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
    once = poses / (settings.poses_per_second or settings.fps)
    usual = once if settings.camera == "still" else max(once, LEAST_SECONDS)
    if keys is not None:
        usual = max(float(keys["time"][-1]), 1 / settings.fps)
    seconds = settings.seconds or usual
    count = max(1, round(seconds * settings.fps))
    if count * len(settings.angles) > MOST_FRAMES:
        raise InputError(f"--seconds: {count * len(settings.angles):,} frames in all, more than {MOST_FRAMES:,}")
    path = pd.DataFrame({"time": np.arange(count) / settings.fps})
    if keys is not None:
        moving = {name: np.interp(path["time"], keys["time"], keys[name]) for name in COLUMNS[1:]}
    else:
        progress = np.arange(count) / count  # a full turn ends where it began, so its last frame is one before
        approaching = np.linspace(settings.far, settings.near, count)
        moving = {
            "azimuth": 360 * settings.turns * progress if settings.camera == "orbit" else 0.0,
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
