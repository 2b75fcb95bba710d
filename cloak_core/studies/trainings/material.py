"""What a training is made of, and which part of it is set aside to choose the best colours."""

from __future__ import annotations

import dataclasses

import numpy as np

from cloak_core.core.settings.components import RunSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.photographs.fits import NOBODY, Fits

_STREAM = 2
"""Of random numbers, apart from those of `sampling`."""


@dataclasses.dataclass(frozen=True, eq=False)
class TrainingData:
    """Bodies, backgrounds, and people in photographs of which images are made."""

    bodies: Bodies
    backgrounds: Backgrounds
    people: Fits = NOBODY


def set_aside(settings: RunSettings, material: TrainingData) -> tuple[TrainingData, TrainingData | None]:
    """Split the material into what is trained on and what is held out (None where `settings.held_out` is 0).

    At least one background is held out, and at least one pose where there are several; a single pose serves both.
    InputError: a single background.
    """
    if not settings.held_out:
        return material, None
    random = np.random.default_rng([settings.seed, _STREAM])
    bodies, backgrounds = material.bodies, material.backgrounds
    if len(backgrounds) < 2:
        raise InputError(f"--held-out {settings.held_out:g}: a single background cannot be split")
    image, held_image = _split(random, len(backgrounds), settings.held_out)
    pose, held_pose = _split(random, bodies.pose_count, settings.held_out) if bodies.pose_count > 1 else ([0], [0])
    people = material.people.people
    photographs = list(dict.fromkeys(person.photograph for person in people))
    apart = {photographs[k] for k in _split(random, len(photographs), settings.held_out)[1]} if photographs else set()
    is_apart = [person.photograph in apart for person in people]
    kept = material.people.select(i for i, is_held in enumerate(is_apart) if not is_held)
    held = material.people.select(i for i, is_held in enumerate(is_apart) if is_held)
    return (
        TrainingData(bodies.select_poses(pose), backgrounds.subset(image), kept),
        TrainingData(bodies.select_poses(held_pose), backgrounds.subset(held_image), held),
    )


def _split(random: np.random.Generator, count: int, share: float) -> tuple[list[int], list[int]]:
    order = random.permutation(count)
    held = min(count - 1, max(1, round(share * count)))
    return sorted(order[held:].tolist()), sorted(order[:held].tolist())
