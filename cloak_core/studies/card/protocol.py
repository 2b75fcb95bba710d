"""What every card measures, in counts: cards of one version and size compare on any machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.logo import chest_thighs, front_faces, shirt_trousers
from cloak_core.exchange.bodies import Bodies

VERSION = "2"
"""Raise it whenever a card of the same detector would come out otherwise."""
FORMAT = f"cloak card {VERSION}"

AREAS = (0.05, 0.20, 0.40, 0.76)
"""Shares of the body's area that the white-box cloaks cover."""
FRONT = "-10:10:5"
"""Training azimuths of the white-box cloaks; distance and elevation are the paper's (2.2 m, 6 degrees)."""
CIRCLE = "0:330:30"
"""Training azimuths of the cloak for the full circle."""
AGAINST = "made against it"
"""What the largest cloak for the front is called on people in photographs."""
CLEAN_ANGLES = tuple(float(a) for a in range(0, 360, 45))
CLEAN_ELEVATIONS = (0.0, 6.0, 15.0, 30.0)
CLEAN_DISTANCES = (1.4, 2.2, 3.2, 4.5, 6.0)

ENOUGH_LARGEST = 150
"""Updates after which the largest cloak is near its end. In our records (success at the detector's own threshold on
76 % of the body) 150 updates reached at least 0.94 of what 300 or 1,500 did: docs/card.md has the table."""
ENOUGH = 600
"""Updates after which any other cloak is. On 20 % of the body 150 updates reached 0.40 to 0.76 of the end, and 300
reached 0.89 of 1,500 for the slowest detector."""


@dataclass(frozen=True)
class Size:
    """How much a card measures; everything is a count."""

    name: str
    steps: int
    """Updates of each white-box cloak; the one for the full circle takes twice as many."""
    seeds: int
    """Repetitions of every training."""
    front_step: int
    """Degrees between the test azimuths in -10 .. 10."""
    circle_step: int
    """Degrees between the test azimuths all around."""
    images_per_view: int
    """Test images of every unseen body at each of those azimuths."""
    clean_images: int
    """Images in own clothing from everywhere: near and far, around, from eye level and above."""
    bare: int
    """Scenes without anybody, for false alarms."""
    people: int
    """People in photographs, the first ones of the file."""
    patterns: int
    """Published patterns, the first ones given."""
    areas: tuple[float, ...] = AREAS
    circle: bool = True
    """Whether a cloak for the full circle is made."""
    pixels: int = 416
    """Width and height of the images."""

    @property
    def front_angles(self) -> tuple[float, ...]:
        """Test azimuths of the front, degrees."""
        return tuple(float(a) for a in range(-10, 11, self.front_step))

    @property
    def circle_angles(self) -> tuple[float, ...]:
        """Test azimuths all around, degrees."""
        return tuple(float(a) for a in range(0, 360, self.circle_step))


# quick has fewer attacks than the others, none that its updates would leave short (`ENOUGH`).
QUICK = Size("quick", 300, 1, 5, 30, 3, 240, 128, 40, 3, areas=AREAS[-1:], circle=False)
STANDARD = Size("standard", 600, 1, 2, 20, 3, 720, 256, 120, 12)
FULL = Size("full", 1500, 3, 1, 15, 4, 1920, 256, 400, 48)
SIZES = {size.name: size for size in (QUICK, STANDARD, FULL)}


def updates_needed(area: float | None) -> int:
    """Count the updates below which an attack is short: on this share of the body (0 to 1), None for all around."""
    return ENOUGH_LARGEST if area == AREAS[-1] else ENOUGH


def nested_areas(bodies: Bodies, shares: tuple[float, ...]) -> list[Int64[np.ndarray, " L"]]:
    """Choose faces of shirt and trousers for each share of the body's area (0 to 1): sorted face ids.

    The front comes before the back, each from the middle of the chest outwards, so every larger logo holds the smaller
    ones; none is more than the garments.
    """
    garments, areas, centres = shirt_trousers(bodies), face_areas(bodies), face_centres(bodies)
    behind = ~front_faces(bodies)[garments]
    away = np.linalg.norm(centres[garments] - _chest(bodies, centres, areas), axis=1)
    order = garments[np.lexsort((garments, away, behind))]
    covered = np.cumsum(areas[order]) / areas.sum()
    counts = (max(1, int(np.searchsorted(covered, share, side="right"))) for share in shares)
    return [np.sort(order[:count]) for count in counts]


def _chest(
    bodies: Bodies, centres: Float[np.ndarray, "F 3"], areas: Float[np.ndarray, " F"]
) -> Float[np.ndarray, " 3"]:
    """The chest's middle: of the region of that name, or of the upper half of what a scene has for it."""
    if "chest" in bodies.regions:
        chest = np.flatnonzero(bodies.regions["chest"] & front_faces(bodies))
    else:
        chest = chest_thighs(bodies)
        height = centres[chest, 1]
        chest = chest[height > (height.min() + height.max()) / 2]
    return np.average(centres[chest], axis=0, weights=areas[chest])
