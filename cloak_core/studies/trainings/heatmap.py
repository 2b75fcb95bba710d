"""Where a logo pays: how strongly each face moves a detector's person score; so the paper chose chest and thighs."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Float

from cloak_core.core.cameras import Camera
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.core.paint import compose
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.view_cache import ViewCache

IMAGES = 4
"""Images a detector is asked about at a time."""


def heatmap(
    bodies: Bodies,
    detector: Detector,
    backgrounds: Backgrounds,
    angles: Sequence[float],
    *,
    backgrounds_per_view: int = 4,
    size: int = 416,
    on_progress: Callable[[int, int], None] | None = None,
) -> Float[np.ndarray, " F"]:
    """Average the size of the gradient of an image's person score by each face's colour.

    Size: absolute values summed over channels; mean over every pose from every angle (azimuths, degrees), each on
    `backgrounds_per_view` backgrounds taken in turn. The body wears its outfits in turn. Faces never seen have 0.
    `on_progress` hears (images done, images in all). InputError when the detector gives no gradients.
    """
    if not detector.differentiable:
        raise InputError(f"--detector {detector.spec}: gives no gradients, so no heat map")
    device = detector.device
    view_cache = ViewCache(bodies, RenderSettings(device=device))
    faces = np.arange(bodies.face_count)
    total = torch.zeros(bodies.face_count, device=device)
    per_view = min(backgrounds_per_view, len(backgrounds))
    views = [(pose, float(azimuth)) for pose in range(bodies.pose_count) for azimuth in angles]
    for done, (pose, azimuth) in enumerate(views):
        outfit = done % bodies.outfit_count
        view = view_cache.bake(pose, Camera(azimuth=azimuth, width=size, height=size), faces, outfit)
        worn = torch.tensor(bodies.face_colors[outfit], device=device)
        for first in range(0, per_view, IMAGES):
            count = done * per_view + first
            chosen = [(count + i) % len(backgrounds) for i in range(min(IMAGES, per_view - first))]
            behind = backgrounds.batch(chosen, size, size).to(device)
            colors = worn.expand(len(chosen), -1, -1).clone().requires_grad_()
            images = compose([view] * len(chosen), colors, behind)
            max_person_score(detector(images)).sum().backward()
            total += colors.grad.abs().sum(dim=(0, 2))
            if on_progress:
                on_progress(count + len(chosen), len(views) * per_view)
    if not torch.isfinite(total).all():
        raise InputError(f"--detector {detector.spec}: the gradient of its score is not finite")
    return (total / max(len(views) * per_view, 1)).cpu().numpy()
