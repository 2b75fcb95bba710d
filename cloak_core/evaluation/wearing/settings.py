"""Settings of `cloak wear`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cloak_core.attack.settings.values import Bounds


@dataclass(frozen=True, kw_only=True)
class WearSettings:
    """How people in photographs are dressed and judged."""

    context: Annotated[float, Bounds(1, 8)] = 1.25
    """Side of each image, in heights of the person's box."""
    size: Annotated[int, Bounds(64, 4096)] = 416
    """Width and height of each image, pixels."""
    threshold: Annotated[float, Bounds(0, 1, "()")] = 0.6
    """A person counts as found above this score; the detectors' own thresholds stand beside it."""
    bare: Annotated[int, Bounds(0, 1024)] = 16
    """Backgrounds without people on which false alarms are counted."""
    batch: Annotated[int, Bounds(1, 1024)] = 8
    """Images that a detector sees at a time."""
    pairs: Annotated[int, Bounds(0, 1000)] = 0
    """With --out: write rate.html, at most this many pairs of COLORS and own clothing on the same person, for people to
    compare who do not know what is what, and rate-key.csv, its key."""
