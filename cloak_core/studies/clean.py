"""Check detectors on clean images before they are attacked: recall, false alarms, agreement with the original.

Of a detector behind masks also the certified recall: people whom one small patch cannot hide.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation import CLOTHING
from cloak_core.core.evaluation.measure import batches, measure
from cloak_core.core.evaluation.results import NOBODY
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.evaluation.statistics import undetected
from cloak_core.core.evaluation.trials import make_trials
from cloak_core.core.images import ImageSet, Indices
from cloak_core.core.logo import Cover
from cloak_core.core.pattern import Pattern
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.detectors.check import read_image
from cloak_core.detectors.defended.masks import Masks
from cloak_core.detectors.verification.kit import CHECKS, framed, natural_size, verify
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.patterns.controls import OwnClothing
from cloak_core.sources.backdrops.backgrounds import SUFFIXES, Backgrounds, load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.studies.imagery import body_images
from cloak_core.studies.opening import clothes_cover

SHIFT = (50, 20)
"""The body is moved by up to this many pixels, right or left and up or down: it stays in the picture."""
SIZE = 416
BATCH = 16


def check_scene(
    detector: Detector,
    bodies: Bodies,
    backgrounds: Backgrounds,
    angles: Sequence[float],
    *,
    images_per_view: int = 6,
    seed: int = 0,
) -> dict:
    """Measure recall on clean renders, and false alarms on bare backgrounds.

    Every body in its first outfit, at every angle (azimuths, degrees; distance 2.2, elevation 6), before
    `images_per_view` backgrounds drawn at random, moved by up to `SHIFT` pixels. Returns {"clean_recall",
    "false_alarms": at 0.6, "clean_recall_own", "false_alarms_own": at the detector's "operating_point",
    "operating_point_assumed": nobody said which that is, "n": renders, "backgrounds": bare backgrounds,
    "alarms": the names and best scores of backgrounds above either threshold, the worst first}, and `certified_recall`.
    """
    if not len(angles):
        raise InputError("--angles: none given")
    rng = np.random.default_rng(seed)
    pose = np.repeat(np.arange(bodies.pose_count), len(angles) * images_per_view)
    angle = np.tile(np.repeat(np.asarray(angles, np.float32), images_per_view), bodies.pose_count)
    camera = Camera(width=SIZE, height=SIZE)
    background = rng.integers(len(backgrounds), size=len(pose))
    shift = np.stack([rng.integers(-s, s, len(pose), endpoint=True) for s in SHIFT], 1)
    trials = make_trials(pose, angle, camera.elevation, camera.distance, background, shift)
    clothing, own = _own(bodies), detector.operating_point
    images = body_images(bodies, backgrounds, trials, RenderSettings(device=detector.device), camera, [clothing])
    rates, bare = _check(detector, images, clothing, "score", np.arange(len(backgrounds)))
    alarms = bare[(bare["score"] > min(THRESHOLD, own)).to_numpy()]
    alarms = alarms.sort_values("score", ascending=False, kind="stable")[["background", "score"]].to_numpy()
    return rates | {
        "false_alarms": _found(bare, THRESHOLD),
        "false_alarms_own": _found(bare, own),
        "backgrounds": len(backgrounds),
        "alarms": [{"background": backgrounds.names[int(i)], "score": round(float(score), 4)} for i, score in alarms],
    }


def check_people(detector: Detector, people: Crowd) -> dict:
    """Measure recall on people in photographs as they are, in the crops of `cloak wear`.

    Returns {"clean_recall": share with a box on them above 0.6, "clean_recall_own", "operating_point",
    "operating_point_assumed", "n": people}, and `certified_recall`.
    """
    images = people.images(load_backgrounds("procedural:test:1"), WearSettings(), detector.device)
    return _check(detector, images, OwnClothing(clothes_cover()), "score_on")[0]


def _check(
    detector: Detector, images: ImageSet, own_clothing: Pattern, column: str, bare: Indices = ()
) -> tuple[dict, pd.DataFrame]:
    """Measure own clothing; return recall by this column of the results, and the rows of bare backgrounds."""
    spec, own = detector.spec, detector.operating_point
    results = measure(images, {CLOTHING: own_clothing}, {spec: detector}, bare, batch=BATCH)
    rows = results.rows(spec, CLOTHING)
    rates = {"clean_recall": _found(rows, THRESHOLD, column), "clean_recall_own": _found(rows, own, column)}
    rates |= {"operating_point": own, "operating_point_assumed": detector.operating_point_assumed, "n": len(rows)}
    return rates | certified_recall(detector, images, own_clothing, THRESHOLD), results.rows(spec, NOBODY)


def _found(rows: pd.DataFrame, threshold: float, column: str = "score") -> float:
    return float((~undetected(rows, threshold, column)).mean())


@torch.no_grad()
def certified_recall(detector: Detector, shown: ImageSet, own_clothing: Pattern, threshold: float) -> dict:
    """Certify the people of images against one patch (`detectors.defended.masks`).

    Returns {"certified_recall": share of images in which the answer under every mask has a box on the person above
    `threshold`, "certified_recall_own", "patch": side in pixels}; {} for a detector that is not `masked=...`.
    """
    masks = getattr(detector, "defence", None)
    if not isinstance(masks, Masks):
        return {}
    floor = []  # the best score on each person, the least over all masks
    for batch in batches(np.arange(len(shown.trials)), BATCH):
        views = shown.views(batch, own_clothing)
        answers = masks.answers(detector.inner, shown.render(batch, own_clothing))
        floor.append(torch.stack([shown.judged(answer, views, batch)[1].person for answer in answers]).amin(0))
    kept = [float((torch.cat(floor) > t).double().mean()) for t in (threshold, detector.operating_point)]
    return {"certified_recall": kept[0], "certified_recall_own": kept[1], "patch": masks.patch}


def clean_renders(count: int, size: tuple[int, int]) -> UInt8[Tensor, "B 3 H W"]:
    """Render the unseen sample bodies as bytes, (height, width) `size`.

    In all their outfits, from all around, 1.6 to 4 m away, before procedural scenes.
    """
    bodies = sample_bodies("unseen")
    backgrounds = load_backgrounds("procedural:test", size)
    rng = np.random.default_rng([0, 0xC1EA])
    angle, distance = rng.uniform(-180, 180, count), rng.uniform(1.6, 4, count)
    background, outfit = rng.integers(len(backgrounds), size=count), rng.integers(len(bodies.face_colors), size=count)
    pose = np.arange(count) % bodies.pose_count
    trials = make_trials(pose, angle, 6, distance, background, np.zeros((count, 2)), outfit)
    camera, clothing = Camera(height=size[0], width=size[1]), _own(bodies)
    # No view comes twice.
    images = body_images(bodies, backgrounds, trials, RenderSettings(memory_bytes=0), camera, [clothing])
    renders = torch.zeros(count, 3, *size, dtype=torch.uint8)
    for batch in batches(np.arange(count), BATCH):
        renders[batch] = as_bytes(images.render(batch, clothing))
    return renders


def as_bytes(images: Float[Tensor, "*B 3 H W"]) -> UInt8[Tensor, "*B 3 H W"]:
    """Convert images in [0, 1] to bytes."""
    return (images * 255).round().to(torch.uint8)


def _own(bodies: Bodies) -> OwnClothing:
    """Wear nothing: one face stands for the logo, in its own colour."""
    return OwnClothing(Cover(np.zeros(1, np.int64), bodies.topology))


def verify_specs(
    specs: Sequence[str],
    load: Callable[[str], Detector],
    folder: Path | None = None,
    renders: int = 4,
    original: Detector | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, dict]:
    """Run `verify` for each spec on the folder's pictures and on renders of the sample bodies; return the reports.

    original: a detector that all of them must agree with; None for the one that `verify` finds. on_progress: hears
    (steps done, steps in all) once the first spec is loaded: rendering, and each check, of each spec.
    """
    reports, done, total = {}, itertools.count(), (len(CHECKS) + 2) * len(specs)
    tell = lambda: on_progress(next(done), total)
    for spec in specs:
        detector = load(spec)
        tell()
        images = sample_images(natural_size(detector), folder, renders)
        tell()
        reports[spec] = verify(detector, images, original, tell)
    return reports


def sample_images(size: tuple[int, int], folder: Path | None, renders: int) -> UInt8[Tensor, "B 3 H W"]:
    """Collect photographs, letterboxed, then renders. InputError: no pictures in the folder."""
    rendered = clean_renders(renders, size)
    if folder is None:
        return rendered
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    files = [
        path for path in sorted(folder.iterdir()) if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
    ]
    if not files:
        raise InputError(f"{folder}: holds no pictures ({', '.join(SUFFIXES)})")
    return torch.cat([torch.stack([as_bytes(framed(read_image(path), size)) for path in files]), rendered])
