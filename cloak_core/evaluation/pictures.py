"""The pictures an evaluation keeps: which images are shown is decided by rule, before anyone has seen a score."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from cloak_core.detectors.protocol import Detector
from cloak_core.detectors.scoring import max_person_score, person_boxes
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.measurement import Measurement, Trials
from cloak_core.evaluation.stage import Stage
from cloak_core.scene.pictures import save_picture

BODIES = 3
ANGLES = 5
FAILURES = 6
WORST = 10
SIDES = {"front": 0.0, "left": 90.0, "back": 180.0, "right": 270.0}
"""Azimuths of the flat views; left and right are the body's own."""


@torch.no_grad()
def write_pictures(
    folder: Path, stage: Stage, measurement: Measurement, detectors: dict[str, Detector], threshold: float
) -> dict:
    """Write the pictures into `folder` (JPEG and PNG) and return what they show, ready for JSON.

    `gallery`: the first image drawn of up to 3 bodies at up to 5 angles (evenly spaced), in own clothing and cloaked;
    `failures`: per detector, the cloaked images with the highest scores above the threshold; `worst`: per detector, of
    the bodies that the cloak hides least often the image with the highest score, and its success; `controls`: one image
    under every control; `flat`: the first body from four sides in the plain colours, without light and shade.
    """
    told, judges = (folder, stage), (detectors, threshold)
    shown = gallery_trials(stage.trials)
    middle = shown[len(shown) // (2 * len(np.unique(stage.trials.pose[shown])))]
    failures, worst = {}, {}
    for d, spec in enumerate(measurement.specs):
        failures[spec] = [shoot_pair(*told, i, *judges) for i in failure_trials(measurement, d, threshold)]
        trials = worst_trials(measurement, d, threshold)
        worst[spec] = [shoot_pair(*told, trial, *judges) | {"success": rate} for trial, rate in trials]
    return {
        "gallery": [shoot_pair(*told, trial, *judges) for trial in shown],
        "failures": failures,
        "worst": worst,
        "controls": label(stage, middle) | {"images": shoot(*told, middle, measurement.controls, *judges)},
        "flat": {side: _flat(folder, stage, side, azimuth) for side, azimuth in SIDES.items()},
    }


@torch.no_grad()
def shoot_pair(folder: Path, stage: Stage, trial: int, detectors: dict[str, Detector], threshold: float) -> dict:
    """One trial in own clothing and cloaked: both pictures written into `folder`, what they show and what was found."""
    return label(stage, trial) | shoot(folder, stage, trial, (CLOTHING, LOGO), detectors, threshold)


def gallery_trials(trials: Trials) -> list[int]:
    """The first image of each shown body (three, evenly spaced) at each shown angle (five, likewise), in that order; of
    a body without an image at that angle (few images were asked for), the one nearest to it, once."""
    angles, bodies = _spaced(np.unique(trials.angle), ANGLES), _spaced(np.unique(trials.pose), BODIES)
    images = [np.flatnonzero(trials.pose == p) for p in bodies]
    return list(dict.fromkeys(int(own[np.abs(trials.angle[own] - a).argmin()]) for own in images for a in angles))


def _spaced(values: np.ndarray, count: int) -> np.ndarray:
    """At most so many of the values, evenly."""
    return values[np.linspace(0, len(values) - 1, min(count, len(values))).round().astype(int)]


def failure_trials(measurement: Measurement, detector: int, threshold: float) -> list[int]:
    """Cloaked images in which the detector still reports a person, the surest first."""
    score = measurement.score[detector, 0]
    worst = np.argsort(-score, kind="stable")[:FAILURES]
    return [int(i) for i in worst if score[i] > threshold]


def worst_trials(measurement: Measurement, detector: int, threshold: float) -> list[tuple[int, float]]:
    """Of the ten bodies with the lowest success, and not all of it, the most certain cloaked image and the success;
    the worst first, equals by their mean score."""
    score, pose = measurement.score[detector, 0], measurement.trials.pose
    rows = []
    for body in np.unique(pose):
        mine = np.flatnonzero(pose == body)
        success = float((score[mine] <= threshold).mean())
        rows.append((success, -float(score[mine].mean()), int(mine[score[mine].argmax()])))
    return [(trial, success) for success, _, trial in sorted(rows)[:WORST] if success < 1]


def label(stage: Stage, trial: int) -> dict:
    """What one trial shows, as plain values."""
    trials = stage.trials
    return {
        "trial": trial,
        "body": stage.bodies.names[int(trials.pose[trial])],
        "angle": float(trials.angle[trial]),
        "distance": round(float(trials.distance[trial]), 4),
        "background": stage.background_names[int(trials.background[trial])],
    }


def shoot(
    folder: Path, stage: Stage, trial: int, controls: Sequence[str], detectors: dict[str, Detector], threshold: float
) -> dict[str, dict]:
    """Render one trial under these controls, write the pictures, and record what each detector sees in them."""
    shots = {}
    for control, image in zip(controls, stage.compose(stage.views([trial]), [trial], controls), strict=True):
        name = f"{trial:05d}-{control}.jpg"
        save_picture(folder / name, to_pil(image[0]), quality=92, subsampling=0)
        boxes, scores = {}, {}
        for spec, detector in detectors.items():
            found = detector(image)
            scores[spec] = round(float(max_person_score(found)[0]), 4)
            boxes[spec] = [[round(v, 4) for v in row] for row in person_boxes(found, threshold)[0].tolist()]
        shots[control] = {"file": name, "boxes": boxes, "scores": scores}
    return shots


def _flat(folder: Path, stage: Stage, side: str, azimuth: float) -> str:
    """The first body with the trained colours, evenly lit, cut out of its background."""
    rgba = stage.flat_view(azimuth)
    name = f"flat-{side}.png"
    save_picture(folder / name, Image.fromarray((rgba * 255).round().byte().cpu().numpy(), "RGBA"), optimize=True)
    return name


def to_pil(image: Float[Tensor, "3 H W"]) -> Image.Image:
    """An image in [0, 1] as a picture."""
    return Image.fromarray((image.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).cpu().numpy())
