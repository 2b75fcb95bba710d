"""Is a detector fit to be attacked: does it find clean bodies, and is it silent where nobody is?"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from cloak_core.detectors import THRESHOLD
from cloak_core.detectors.protocol import Detector
from cloak_core.detectors.scoring import is_detected
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.render.compositing import compose
from cloak_core.render.views import ViewBank
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.cameras import Camera

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
    "false_alarms", "n": renders, "backgrounds": bare backgrounds}.
    """
    if not len(angles):
        raise InputError("--angles: none given")
    rng = np.random.default_rng(seed)
    bank = ViewBank(bodies, device=detector.device)
    # One face stands for the logo, in its own colour: the body as it is.
    face = np.zeros(1, np.int64)
    own = torch.from_numpy(bodies.face_colors[0, face]).to(detector.device)
    views = [
        (pose, Camera(azimuth=float(a), width=SIZE, height=SIZE)) for pose in range(len(bodies.names)) for a in angles
    ]
    renders = [view for view in views for _ in range(images_per_view)]
    drawn = rng.integers(len(backgrounds), size=len(renders))
    shifts = torch.from_numpy(np.stack([rng.integers(-s, s, len(renders), endpoint=True) for s in SHIFT], 1))

    def render(chosen: range) -> torch.Tensor:
        dressed = [bank.dress(*renders[i], face, 0) for i in chosen]
        behind = backgrounds.batch([int(drawn[i]) for i in chosen], SIZE, SIZE).to(detector.device)
        return compose(dressed, own, behind, shifts[chosen.start : chosen.stop], None)

    def bare(chosen: range) -> torch.Tensor:
        return backgrounds.batch(list(chosen), SIZE, SIZE).to(detector.device)

    return {
        "clean_recall": _share(detector, render, len(renders), threshold),
        "false_alarms": _share(detector, bare, len(backgrounds), threshold),
        "n": len(renders),
        "backgrounds": len(backgrounds),
    }


def _share(detector: Detector, images: Callable[[range], torch.Tensor], count: int, threshold: float) -> float:
    found = 0
    for first in range(0, count, BATCH):
        found += int(is_detected(detector(images(range(first, min(first + BATCH, count)))), threshold).sum())
    return found / count
