"""How far a training or another long command is.

A live bar in a terminal, plain lines in a pipe, on standard error either way; a file of events for programs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cloak_core.commands.base import err, require_new

PLAIN_EVERY = 10.0
"""Seconds between lines where there is no terminal."""


class TrainingProgress:
    """Takes a run's events ("start" with the number of steps, then one "step" each) and shows how it goes."""

    def __init__(self, silent: bool = False) -> None:
        columns = (TextColumn("training"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[figures]}"))
        times = (TimeElapsedColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, *times, console=err, disable=silent or not err.is_terminal)
        self._task = self._bar.add_task("training", total=None, figures="")
        self._silent = silent
        self._total: int | None = None
        self._said = -PLAIN_EVERY
        self._success: float | None = None
        self._pace = Pace()

    def __enter__(self) -> TrainingProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if not self._bar.disable:  # rich would write an empty line all the same
            self._bar.stop()

    def __call__(self, event: dict) -> None:
        if self._silent:
            return
        if event.get("type") in ("start", "resume"):
            self._total = event.get("steps")
            self._pace.begin(event.get("step", 0))
        elif event.get("type") == "step":
            self._step(event)

    def _step(self, event: dict) -> None:
        # One batch says little about success: show a running mean over about twenty.
        if isinstance(event.get("success"), (int, float)):
            self._success = (
                event["success"] if self._success is None else 0.95 * self._success + 0.05 * event["success"]
            )
        figures = f"loss {event['loss']:.3f}"
        if self._success is not None:
            figures += f"  success on its last images {self._success:.0%}"
        self._bar.update(self._task, total=self._total, completed=event["step"], figures=figures)
        if not err.is_terminal and (time.monotonic() - self._said >= PLAIN_EVERY or event["step"] == self._total):
            self._said = time.monotonic()
            pace = self._pace.words(event["step"], self._total)
            err.print(f"step {event['step']}/{self._total or '?'}  {figures}  {event['time']:.0f} s{pace}")


class Pace:
    """How quick something counted goes, from when it began."""

    def __init__(self) -> None:
        self.begin(0)

    def begin(self, done: int) -> None:
        """Count from here: what is done already took no time of ours."""
        self._first, self._began = done, time.monotonic()

    def words(self, done: int, total: int | None) -> str:
        """Say the rate and about how long the rest takes; "" before anything can be said, or after the end."""
        worked, seconds = done - self._first, time.monotonic() - self._began
        if worked <= 0 or seconds <= 0 or not total or done >= total:
            return ""
        rate = worked / seconds
        shown = f"{rate:.1f} a second" if rate >= 1 else f"{1 / rate:.1f} s each"
        return f"; {shown}, about {_minutes((total - done) / rate)} left"


@contextmanager
def counted(label: str, events: Path | None = None) -> Iterator[Callable[[int, int], None]]:
    """Yield `tell(done, total)`, which feeds a bar in a terminal and the lines of `events`.

    These are a run's (`attack.events`): "start" with `steps`, the total, as soon as that is known, then "step" with
    `step`, what is done. Both have `time`, the seconds since. InputError: the file is there already.
    """
    from cloak_core.core.events import EventLog

    log = None
    if events is not None:
        require_new(events)
        log = EventLog(events)
    begun = time.monotonic()
    known: int | None = None
    pace, said = Pace(), begun
    columns = (*Progress.get_default_columns(), MofNCompleteColumn())
    with Progress(*columns, console=err, disable=not err.is_terminal) as bar:
        task = bar.add_task(label, total=None)

        def tell(done: int, total: int) -> None:
            nonlocal known, said
            bar.update(task, completed=done, total=total)
            if not err.is_terminal and time.monotonic() - said >= PLAIN_EVERY:
                said = time.monotonic()
                err.print(f"{label}: {done} of {total}{pace.words(done, total)}")
            seconds = time.monotonic() - begun
            if log is not None and total != known:
                log.write({"type": "start", "step": 0, "time": seconds, "steps": total})
            if log is not None and done:
                log.write({"type": "step", "step": done, "time": seconds})
            known = total

        try:
            yield tell
        finally:
            if log is not None:
                log.close()


class WorkProgress:
    """Takes what is being done, how much of all is done and how much there is in all; shows them and the time left.

    What was found done already takes no time, and tells nothing of how long the rest will.
    """

    def __init__(self, silent: bool = False) -> None:
        self._silent, self._said, self._spent, self._worked = silent, -PLAIN_EVERY, 0.0, 0.0
        self._done, self._at, self._label = 0.0, time.monotonic(), ""

    def __call__(self, label: str, done: float, total: float) -> None:
        now = time.monotonic()
        if now - self._at > QUICK and done > self._done:
            self._spent, self._worked = self._spent + now - self._at, self._worked + done - self._done
        self._done, self._at = done, now
        if not self._silent and (now - self._said >= PLAIN_EVERY or label != self._label):
            self._said, self._label = now, label
            left = f", about {_minutes(self.left(total))} left" if self._worked else ""
            err.print(f"{label}: {done / total:.0%}{left}")

    def left(self, total: float) -> float:
        """Estimate the seconds that the rest will take at the pace so far."""
        return (total - self._done) * self._spent / max(self._worked, 1e-9)


QUICK = 0.002
"""Seconds; a report that comes sooner is of something that was done before."""


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"
