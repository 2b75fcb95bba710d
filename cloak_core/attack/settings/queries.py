"""Settings of `attack.black_box`: colours from a detector's answers alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cloak_core.attack.settings.values import Bounds


@dataclass(frozen=True, kw_only=True)
class QuerySettings:
    """How a detector is asked that gives no gradient."""

    black_box_queries: Annotated[int | None, Bounds(1, 10_000_000)] = None
    """Search with the detectors' answers alone, showing them so many images in all; best from transferred colours
    (--init). Steps, optimiser and loss then mean nothing; None trains by gradients."""
    query_change: Annotated[float, Bounds(0, 1, "(]")] = 0.1
    """How far a question moves colours to either side, in units of colour."""
    query_lr: Annotated[float, Bounds(0, 1, "(]")] = 0.02
    """How far an answer that agrees with those before moves them."""
