"""Settings of `attack.people`: how photographs of people are shown to training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cloak_core.core.settings.values import Bounds, Range


@dataclass(frozen=True, kw_only=True)
class PeopleSettings:
    """How photographs of people are shown, where there are any (--people)."""

    people_share: Annotated[float, Bounds(0, 1)] = 1.0
    """Share of the images that are photographs; the others are renders of the scene. Without a scene all are."""
    people_context: Annotated[Range, Bounds(1, 8)] = Range(1.1, 2.0)
    """LOW:HIGH of an image's side, in heights of the person's box."""
    people_shift: Annotated[float, Bounds(0, 0.5)] = 0.1
    """The person may stand anywhere that keeps her in the image, and be cut by up to this share of her height."""
    people_mirror: Annotated[float, Bounds(0, 1)] = 0.5
    """Share of the photographs that are mirrored."""
    people_loose: Annotated[float, Bounds(0, 0.2)] = 0.02
    """Faces lie off their fitted places by up to this many heights of the person, and are stretched by twice that."""
    people_light: Annotated[float, Bounds(0, 0.9)] = 0.3
    """Exposure of the cloak in the photograph changes by up to this share, the depth of folds by twice as much."""
    people_soft: Annotated[float, Bounds(0, 3)] = 0.8
    """The resampling kernel is wider by up to this much: softer lenses, lower resolution."""
