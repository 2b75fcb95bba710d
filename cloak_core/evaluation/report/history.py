"""Read the curves of a training from its events.jsonl."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from cloak_core.attack.events import read_events

NAMES = {"loss": "loss", "disappearance": "disappearance", "tv": "total variation"}


@dataclass(frozen=True)
class History:
    """Curves of (step, value), and how the training ended."""

    losses: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    success: list[tuple[float, float]] = field(default_factory=list)
    step: int = 0
    seconds: float = 0.0
    outcome: str = ""


def read_history(run: Path) -> History:
    """Read losses and success over the steps; empty where the run has no events."""
    path = run / "events.jsonl"
    events = read_events(path) if path.exists() else []
    steps = [e for e in events if e.get("type") == "step"]
    losses = {label: points for key, label in NAMES.items() if (points := _points(steps, key))}
    ends = [e for e in events if e.get("type") == "end"]
    return History(
        losses=losses,
        success=_points(steps, "success"),
        step=int(max((e["step"] for e in steps if _is_number(e.get("step"))), default=0)),
        seconds=float(max((e["time"] for e in events if _is_number(e.get("time"))), default=0.0)),
        outcome=str(ends[-1].get("outcome", "")) if ends else "",
    )


def _points(steps: list[dict], key: str) -> list[tuple[float, float]]:
    return [(float(e["step"]), float(e[key])) for e in steps if _is_number(e.get("step")) and _is_number(e.get(key))]


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
