"""The faces that white-box cloaks of growing area cover: nested, and chosen by rule."""

from __future__ import annotations

import numpy as np

from cloak_core.evaluation.experiments.logos import FaceIds, chest_thighs, shirt_trousers
from cloak_core.exchange.bodies import Bodies
from cloak_core.scene.geometry import face_areas, face_centres
from cloak_core.scene.logos.logo import front_faces


def nested_areas(bodies: Bodies, shares: tuple[float, ...]) -> list[FaceIds]:
    """For each share of the body's area (0 to 1), faces of shirt and trousers: what is in front before the back, each
    from the middle of the chest outwards. So every larger one holds the smaller; none is more than the garments."""
    garments, areas = shirt_trousers(bodies), face_areas(bodies)
    centres = face_centres(bodies)
    behind = ~front_faces(bodies)[garments]
    away = np.linalg.norm(centres[garments] - _chest(bodies, centres, areas), axis=1)
    order = garments[np.lexsort((garments, away, behind))]
    covered = np.cumsum(areas[order]) / areas.sum()
    counts = (max(1, int(np.searchsorted(covered, share, side="right"))) for share in shares)
    return [np.sort(order[:count]) for count in counts]


def _chest(bodies: Bodies, centres: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """The chest's middle: of the region of that name, or of the upper half of what a scene has for it."""
    if "chest" in bodies.regions:
        chest = np.flatnonzero(bodies.regions["chest"] & front_faces(bodies))
    else:
        chest = chest_thighs(bodies)
        height = centres[chest, 1]
        chest = chest[height > (height.min() + height.max()) / 2]
    return np.average(centres[chest], axis=0, weights=areas[chest])
