"""Shoots the takes of a film and keeps what every detector says of every frame, cloaked and in own clothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64, Int64

from cloak_core.detectors.protocol import Detector
from cloak_core.detectors.scoring import max_person_score, person_boxes
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.film.camera_path import CameraPath
from cloak_core.evaluation.film.settings import FilmSettings
from cloak_core.evaluation.inference import OnProgress, Progress, batches, max_score_on
from cloak_core.evaluation.measurement import Trials
from cloak_core.evaluation.stage import Stage
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.render.views import ViewBank
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.cameras import Camera
from cloak_core.scene.logos.logo import Logo

CONTROLS = (LOGO, CLOTHING)
"""What is filmed side by side."""
VIEW_BYTES = 1 << 30
"""Of views kept between measuring a film and drawing it."""
LEAST_PIXELS = 8
"""A body whose box is narrower or lower than this is counted as not in the picture."""


@dataclass(frozen=True, eq=False)
class Footage:
    """What D detectors say of N frames, all takes one after the other, under both of `CONTROLS`."""

    specs: tuple[str, ...]
    own: tuple[float, ...]
    """The detectors' own thresholds."""
    trials: Trials
    time: Float64[np.ndarray, N]
    """Seconds from the beginning of the take."""
    take: Int64[np.ndarray, N]
    score: Float32[np.ndarray, "D 2 N"]
    """The best person score anywhere in the frame."""
    score_on: Float32[np.ndarray, "D 2 N"]
    """The best one on the body (IoU with its true box at least 0.5)."""
    boxes: list[list[list[Float[np.ndarray, "_ 5"]]]]
    """By detector, control and frame: x1, y1, x2, y2, score above the lower of both thresholds, best first."""
    true: Float32[np.ndarray, "N 4"]
    """The body's box, pixels."""

    @property
    def in_picture(self) -> Bool[np.ndarray, N]:
        """Whether there is a body to be found."""
        return (self.true[:, 2:] - self.true[:, :2] >= LEAST_PIXELS).all(1)


def make_stage(
    colors: Float32[np.ndarray, "L 3"],
    logo: Logo,
    bodies: Bodies,
    backgrounds: Backgrounds,
    path: CameraPath,
    settings: FilmSettings,
    device: torch.device | str = "cpu",
) -> Stage:
    """The frames of all takes, ready to be rendered: poses in their order, again and again; a background and an outfit
    for each take, the next ones in turn."""
    if settings.outfit >= bodies.outfit_count:
        raise InputError(f"--outfit: there is no outfit {settings.outfit}, the scene has {bodies.outfit_count}")
    takes, count = len(settings.angles), len(path)
    take = np.repeat(np.arange(takes), count)
    again = lambda values: np.tile(values, takes)
    step = np.floor(path.time * (settings.poses_per_second or settings.fps) + 1e-6).astype(np.int64)
    trials = Trials(
        pose=again(step % bodies.pose_count),
        angle=again(path.azimuth) + np.asarray(settings.angles, np.float32)[take],
        elevation=again(path.elevation),
        distance=again(path.distance),
        background=take % len(backgrounds),
        shift=np.zeros((takes * count, 2), np.int64),
        outfit=(settings.outfit + take) % bodies.outfit_count,
    )
    viewpoint = Camera(field_of_view=settings.field_of_view, width=settings.size, height=settings.size)
    if not settings.follow:
        viewpoint = replace(viewpoint, pivot=middle_of(bodies))
    # A film's views are of no use to anything else: none is written to files.
    bank = ViewBank(bodies, samples=settings.samples, device=device, memory_bytes=VIEW_BYTES)
    return Stage(colors, logo, bodies, backgrounds, trials, viewpoint, bank)


def middle_of(bodies: Bodies) -> tuple[float, float, float]:
    """The mean of the poses' middles, metres."""
    middles = (bodies.vertices.min(1).astype(np.float64) + bodies.vertices.max(1)) / 2
    return tuple(middles.mean(0).tolist())


@torch.no_grad()
def shoot_film(
    stage: Stage,
    path: CameraPath,
    detectors: dict[str, Detector],
    settings: FilmSettings,
    on_progress: OnProgress | None = None,
) -> Footage:
    """Show every frame under both controls to every detector."""
    judges, count = list(detectors.values()), len(stage.trials)
    progress = Progress(2 * count, on_progress)
    score = np.zeros((len(judges), len(CONTROLS), count), np.float32)
    score_on, true = np.zeros_like(score), np.zeros((count, 4), np.float32)
    boxes: list = [[[] for _ in CONTROLS] for _ in judges]
    for batch in batches(np.arange(count), settings.batch):
        views = stage.views(batch)
        bodies = stage.boxes(views, batch)
        true[batch] = bodies.cpu().numpy()
        for c, images in enumerate(stage.compose(views, batch, CONTROLS)):
            for d, detector in enumerate(judges):
                found = detector(images)
                score[d, c, batch] = max_person_score(found).cpu().numpy()
                score_on[d, c, batch] = max_score_on(found, bodies).cpu().numpy()
                least = min(settings.threshold, detector.operating_point)
                boxes[d][c] += [rows.numpy() for rows in person_boxes(found, least)]
            progress.advance(len(batch))
    takes = len(settings.angles)
    own = tuple(float(detector.operating_point) for detector in judges)
    again = np.tile(path.time, takes), np.repeat(np.arange(takes), len(path))
    return Footage(tuple(detectors), own, stage.trials, *again, score, score_on, boxes, true)


def above(boxes: Sequence[Float[np.ndarray, "_ 5"]], threshold: float) -> list[Float[np.ndarray, "_ 5"]]:
    """Of every frame's boxes those above a threshold."""
    return [rows[rows[:, 4] > threshold] for rows in boxes]
