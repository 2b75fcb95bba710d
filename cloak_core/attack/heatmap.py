"""Where a logo pays: how strongly each face moves a detector's person score; so the paper chose chest and thighs."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int

from cloak_core.detectors.protocol import Detector
from cloak_core.detectors.scoring import max_person_score
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.render.compositing import compose
from cloak_core.render.views import ViewBank
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.cameras import Camera
from cloak_core.scene.geometry import face_areas

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
    device: str | torch.device = "cpu",
) -> Float[np.ndarray, "F"]:
    """Mean size of the gradient of an image's person score with respect to each face's colour.

    Size: absolute values summed over channels; mean over every pose from every angle (azimuths, degrees), each on
    `backgrounds_per_view` backgrounds taken in turn. The body wears its outfits in turn. Faces never seen have 0.
    InputError when the detector gives no gradients.
    """
    if not detector.differentiable:
        raise InputError(f"--detector {detector.spec}: gives no gradients, so no heat map")
    device = torch.device(device)
    bank = ViewBank(bodies, device=device)
    faces = np.arange(bodies.face_count)
    total = torch.zeros(bodies.face_count, device=device)
    per_view = min(backgrounds_per_view, len(backgrounds))
    count = 0
    for pose in range(bodies.pose_count):
        for azimuth in angles:
            outfit = count // per_view % bodies.outfit_count
            view = bank.dress(pose, Camera(azimuth=float(azimuth), width=size, height=size), faces, outfit)
            worn = torch.tensor(bodies.face_colors[outfit], device=device)
            for first in range(0, per_view, IMAGES):
                chosen = [(count + i) % len(backgrounds) for i in range(min(IMAGES, per_view - first))]
                behind = backgrounds.batch(chosen, size, size).to(device)
                colors = worn.expand(len(chosen), -1, -1).clone().requires_grad_()
                images = compose([view] * len(chosen), colors, behind, None, None)
                max_person_score(detector(images)).sum().backward()
                total += colors.grad.abs().sum(dim=(0, 2))
                count += len(chosen)
    if not torch.isfinite(total).all():
        raise InputError(f"--detector {detector.spec}: the gradient of its score is not finite")
    return (total / max(count, 1)).cpu().numpy()


def pick(heat: Float[np.ndarray, "F"], bodies: Bodies, share: float) -> Int[np.ndarray, "L"]:
    """[L] int64 sorted ids of the faces with the most heat per area that make up `share` of the body's area.

    Per area, because a large face gathers gradient from more pixels: what counts is the gain of each square metre.
    """
    if not 0 < share <= 1:
        raise InputError(f"--pick {share}: a share of the area in (0, 1] is needed")
    if len(heat) != bodies.face_count:
        raise InputError(f"a heat map of {len(heat)} faces for a body of {bodies.face_count}")
    areas = np.asarray(face_areas(bodies), np.float64)
    density = np.divide(heat, areas, out=np.zeros(len(heat)), where=areas > 0)
    order = np.argsort(-density, kind="stable")
    order = order[heat[order] > 0]
    if not len(order):
        raise InputError("the heat map is zero everywhere: no face moves the detector's score")
    # The last face that still fits by half: the area taken is the nearest to what was asked.
    taken = np.searchsorted(np.cumsum(areas[order]) - areas[order] / 2, share * areas.sum())
    return np.sort(order[: max(1, taken)]).astype(np.int64)
