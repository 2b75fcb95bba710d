"""What every card measures, under a version number: cards of one version and budget can be compared."""

from __future__ import annotations

from dataclasses import dataclass

VERSION = "1"
"""Raised whenever a card of the same detector would come out otherwise."""

AREAS = (0.05, 0.20, 0.40, 0.76)
"""Shares of the body's area that the white-box cloaks cover."""
FRONT = "-10:10:5"
"""Training azimuths of the white-box cloaks; distance and elevation are the paper's (2.2 m, 6 degrees)."""
CIRCLE = "0:330:30"
"""Training azimuths of the cloak for the full circle."""
CLEAN_ANGLES = tuple(float(a) for a in range(0, 360, 45))
CLEAN_ELEVATIONS = (0.0, 6.0, 15.0, 30.0)
CLEAN_DISTANCES = (1.4, 2.2, 3.2, 4.5, 6.0)


@dataclass(frozen=True)
class Budget:
    """How much of it: steps of the attacks and numbers of images."""

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
    areas: tuple[float, ...] = AREAS

    @property
    def front_angles(self) -> tuple[float, ...]:
        return tuple(float(a) for a in range(-10, 11, self.front_step))

    @property
    def circle_angles(self) -> tuple[float, ...]:
        return tuple(float(a) for a in range(0, 360, self.circle_step))


QUICK = Budget("quick", 150, 1, 4, 30, 2, 240)
DEFAULT = Budget("default", 600, 1, 2, 20, 3, 720)
FULL = Budget("full", 1500, 3, 1, 15, 4, 1920)
