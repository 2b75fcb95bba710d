"""Everything that decides how photographs are judged, in one dataclass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cloak_core.attack.settings import check_settings
from cloak_core.attack.settings.values import Bounds
from cloak_core.detectors import IOU, THRESHOLD
from cloak_core.evaluation.intervals import RESAMPLES


@dataclass(frozen=True, kw_only=True)
class JudgeSettings:
    """How to judge photographs."""

    threshold: Annotated[float, Bounds(0, 1, "()")] = THRESHOLD
    """A person counts as detected above this score; the detector's own threshold stands beside it."""
    iou: Annotated[float, Bounds(0, 1, "(]")] = IOU
    """Where a person's box is told: overlap from which a found box is that person's."""
    every: Annotated[int, Bounds(1)] = 10
    """Of a video every so many-th frame is looked at."""
    most_frames: Annotated[int, Bounds(1)] = 50
    """And no more than so many of one video, from its beginning."""
    longest: Annotated[int, Bounds(32, 8192)] = 1280
    """Larger pictures are reduced to so many pixels along their longer side, by averaging, before a detector sees
    them."""
    resamples: Annotated[int, Bounds(100)] = RESAMPLES
    """Bootstrap resamples behind each interval."""

    def __post_init__(self) -> None:
        check_settings(self)
