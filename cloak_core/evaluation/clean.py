"""Is a detector fit to be attacked: does it find clean bodies, and is it silent where nobody is?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from cloak_core.detectors import THRESHOLD
from cloak_core.detectors.protocol import Detector
from cloak_core.detectors.scoring import max_person_score
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.measurement import Trials
from cloak_core.evaluation.stage import Stage
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.render.views import ViewBank
from cloak_core.scene.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.scene.cameras import Camera
from cloak_core.scene.logos.logo import make_logo
from cloak_core.scene.people.samples import sample_bodies

SHIFT = (50, 20)
"""The body is moved by up to this many pixels, right or left and up or down: it stays in the picture."""
SIZE = 416
BATCH = 16


@torch.no_grad()
def check_scene(
    detector: Detector,
    bodies: Bodies,
    backgrounds: Backgrounds,
    angles: Sequence[float],
    *,
    images_per_view: int = 6,
    threshold: float = THRESHOLD,
    seed: int = 0,
) -> dict:
    """Share of clean renders with a person found, and of bare backgrounds with a false alarm.

    Every body in its first outfit, at every angle (azimuths, degrees; distance 2.2, elevation 6), before
    `images_per_view` backgrounds drawn at random, moved by up to `SHIFT` pixels. Returns {"clean_recall",
    "false_alarms": at `threshold`, "clean_recall_own", "false_alarms_own": at the detector's "operating_point",
    "operating_point_assumed": nobody said which that is, "n": renders, "backgrounds": bare backgrounds}.
    """
    if not len(angles):
        raise InputError("--angles: none given")
    rng = np.random.default_rng(seed)
    pose = np.repeat(np.arange(bodies.pose_count), len(angles) * images_per_view)
    angle = np.tile(np.repeat(np.asarray(angles, np.float32), images_per_view), bodies.pose_count)
    camera = Camera(width=SIZE, height=SIZE)
    trials = Trials(
        pose=pose,
        angle=angle,
        elevation=np.full(len(pose), camera.elevation, np.float32),
        distance=np.full(len(pose), camera.distance, np.float32),
        background=rng.integers(len(backgrounds), size=len(pose)),
        shift=np.stack([rng.integers(-s, s, len(pose), endpoint=True) for s in SHIFT], 1),
        outfit=np.zeros(len(pose), np.int64),
    )
    stage = _clean_stage(bodies, backgrounds, trials, camera, ViewBank(bodies, device=detector.device))
    thresholds = (threshold, detector.operating_point)
    recall, recall_own = _shares(detector, partial(stage.images, control=CLOTHING), len(pose), thresholds)
    alarms, alarms_own = _shares(detector, stage.bare, len(backgrounds), thresholds)
    return {
        "clean_recall": recall,
        "false_alarms": alarms,
        "operating_point": detector.operating_point,
        "operating_point_assumed": detector.operating_point_assumed,
        "clean_recall_own": recall_own,
        "false_alarms_own": alarms_own,
        "n": len(pose),
        "backgrounds": len(backgrounds),
    }


def clean_renders(count: int, size: tuple[int, int], seed: int = 0) -> UInt8[Tensor, "B 3 H W"]:
    """Renders of the unseen sample bodies in all their outfits, (height, width) `size`, from all around, 1.6 to 4 m
    away, before procedural scenes; as bytes, a quarter of the memory."""
    bodies, backgrounds = sample_bodies("unseen"), load_backgrounds("procedural:test", size)
    rng = np.random.default_rng([seed, 0xC1EA])
    trials = Trials(
        pose=np.arange(count) % bodies.pose_count,
        angle=rng.uniform(-180, 180, count).astype(np.float32),
        distance=rng.uniform(1.6, 4, count).astype(np.float32),
        elevation=np.full(count, 6, np.float32),
        background=rng.integers(len(backgrounds), size=count),
        shift=np.zeros((count, 2), np.int64),
        outfit=rng.integers(len(bodies.face_colors), size=count),
    )
    bank = ViewBank(bodies, memory_bytes=0)  # no view comes twice
    stage = _clean_stage(bodies, backgrounds, trials, Camera(height=size[0], width=size[1]), bank)
    renders = torch.zeros(count, 3, *size, dtype=torch.uint8)
    for first in range(0, count, BATCH):
        batch = range(first, min(first + BATCH, count))
        renders[first : batch.stop] = as_bytes(stage.images(batch, control=CLOTHING))
    return renders


def as_bytes(images: Float[Tensor, "*B 3 H W"]) -> UInt8[Tensor, "*B 3 H W"]:
    """From [0, 1]."""
    return (images * 255).round().to(torch.uint8)


def _clean_stage(bodies: Bodies, backgrounds: Backgrounds, trials: Trials, camera: Camera, bank: ViewBank) -> Stage:
    """One face stands for the logo, in its own colour: bodies as they are."""
    colors, logo = bodies.face_colors[0, :1], make_logo(bodies, [0])
    return Stage(colors, logo, bodies, backgrounds, trials, viewpoint=camera, bank=bank)


def _shares(
    detector: Detector, images: Callable[[range], torch.Tensor], count: int, thresholds: Sequence[float]
) -> list[float]:
    """Of `count` images, in how many a person is found at each threshold."""
    batches = [range(first, min(first + BATCH, count)) for first in range(0, count, BATCH)]
    best = torch.cat([max_person_score(detector(images(batch))) for batch in batches])
    return [int((best > threshold).sum()) / count for threshold in thresholds]
