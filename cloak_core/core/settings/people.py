"""Settings of `sources.photographs`: how photographs of people are shown to training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cloak_core.core.settings.values import Bounds


@dataclass(frozen=True, kw_only=True)
class PeopleSettings:
    """How photographs of people are shown, where there are any (--people)."""

    people_share: Annotated[float, Bounds(0, 1)] = 1.0
    """Share of the images that are photographs, the others being renders of the scene."""
