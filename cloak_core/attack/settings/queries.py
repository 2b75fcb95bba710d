"""Settings of `attack.black_box`: colours from a detector's answers alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cloak_core.attack.settings.values import Bounds


@dataclass(frozen=True, kw_only=True)
class QuerySettings:
    """How a detector is asked that gives no gradient."""

    black_box_queries: Annotated[int | None, Bounds(1, 10_000_000)] = None
    """Search with the detectors' answers alone, with this many images in all; best begun from transferred colours
    (--init). Steps, optimiser and loss have no effect then. None trains by gradients."""
    query_change: Annotated[float, Bounds(0, 1, "(]")] = 0.1
    """How far a query moves the colours to either side, in units of colour [0, 1]."""
    query_lr: Annotated[float, Bounds(0, 1, "(]")] = 0.02
    """How far the colours follow the estimated gradient in each update, in units of colour [0, 1]."""
