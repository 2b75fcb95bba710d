# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a training is, from the events that it writes."""

import functools
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

TAIL_BYTES = 64 << 10  # of an event log: some three hundred steps, more than the running mean of the success remembers


@dataclass(frozen=True)
class Progress:
    """What a run's events have told so far."""

    step: int = 0
    steps: int = 0
    loss: float | None = None
    success: float | None = None  # share of the last images without a detection, a running mean, 0 to 1
    seconds: float = 0.0  # of training, as the trainer counts them
    seconds_per_step: float | None = None
    outcome: str = ""  # "done", "stopped" or "failed" when its log has ended so; "" else
    why: str = ""  # what a failed run said of itself

    @property
    def fraction(self) -> float:
        return min(1.0, self.step / self.steps) if self.steps else 0.0

    def describe(self) -> str:
        """Steps and time left, as far as they are known."""
        text = f"{self.step}/{self.steps or '?'}"
        if self.seconds_per_step is not None and self.step < self.steps:
            text += f", {duration((self.steps - self.step) * self.seconds_per_step)} left"
        return text

    def figures(self) -> str:
        """Loss and success, as far as they are known."""
        parts = [] if self.loss is None else [f"loss {self.loss:.3f}"]
        if self.success is not None:
            parts.append(f"success {self.success:.0%}")
        return ", ".join(parts)


def duration(seconds: float) -> str:
    """1 h 05 min, 3 min, 40 s."""
    if seconds >= 3600:
        return f"{int(seconds // 3600)} h {int(seconds % 3600 // 60):02d} min"
    return f"{math.ceil(seconds / 60)} min" if seconds >= 90 else f"{math.ceil(seconds)} s"


def read_events(path: Path) -> Progress:
    """What the first and last lines of an event log tell; nothing of one that is not there yet."""
    try:
        with path.open("rb") as file:
            head = file.read(TAIL_BYTES)
            start = max(len(head), path.stat().st_size - TAIL_BYTES)
            file.seek(start)
            tail = file.read(TAIL_BYTES)
    except OSError:
        return Progress()
    if len(head) < start:
        head, tail = head[: head.rfind(b"\n") + 1], tail[tail.find(b"\n") + 1 :]
    return functools.reduce(take_event, (head + tail).splitlines(), Progress())


def take_event(progress: Progress, line: bytes) -> Progress:
    """Progress after one more line of events.jsonl; a line that is no event is passed over."""
    try:
        event = json.loads(line)
        kind = event["type"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return progress
    step, seconds = finite(event.get("step")), finite(event.get("time"))
    if kind == "end":
        return replace(progress, outcome="done" if event.get("outcome") == "done" else "stopped")
    if kind == "error":
        return replace(progress, outcome="failed", why=str(event.get("message", ""))[:200])
    if kind in ("start", "resume", "step"):
        progress = replace(progress, outcome="", why="")
    if kind in ("start", "resume") and finite(event.get("steps")) is not None:
        progress = replace(progress, steps=int(event["steps"]), seconds_per_step=None)
    if kind != "step" or step is None or step < progress.step:
        return progress
    success = finite(event.get("success"))
    if success is not None and progress.success is not None:
        success = 0.95 * progress.success + 0.05 * success  # one batch says little
    pace = progress.seconds_per_step
    if seconds is not None and step > progress.step:
        latest = max(0.0, seconds - progress.seconds) / (step - progress.step)
        pace = latest if pace is None else 0.9 * pace + 0.1 * latest
    return replace(
        progress,
        step=int(step),
        loss=finite(event.get("loss")),
        success=progress.success if success is None else success,
        seconds=progress.seconds if seconds is None else seconds,
        seconds_per_step=pace,
    )


def finite(value: object) -> float | None:
    """A number of a record; None where it is something else, or not finite."""
    usable = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None
