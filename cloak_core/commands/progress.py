"""How far a training or another long command is.

A live bar in a terminal, plain lines in a pipe, on standard error either way; a file of events for programs.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cloak_core.commands.base import err
from cloak_core.files.writing import require_new

if TYPE_CHECKING:
    from cloak_core.studies.store import RunStore

PLAIN_EVERY = 10.0
"""Seconds between lines where there is no terminal."""
SOON = 2.0
"""Seconds of work after which something is said of the time left."""
QUICK = 0.002
"""Seconds; a report that comes sooner is of something that was done before."""


def announce(work: str, total: int, seconds: float | None = None, *, unit: str) -> None:
    """Say at the start of long work what there is to do, and about how long it takes where that is known.

    work: what is done; total, unit: how much of what. What is known later, `Pace` says.
    """
    about = "" if seconds is None else f", about {_minutes(seconds)} on this machine"
    err.print(f"{work}: {total:,} {unit.removesuffix('s') if total == 1 else unit}{about}")


class Pace:
    """How quick something counted goes, from the first report on: the first waits for compilers and files.

    What is reported without having taken any time was found done, and counts for nothing.
    """

    def __init__(self) -> None:
        self.begin(0)

    def begin(self, done: float) -> None:
        """Count from here: what is done already took no time of ours."""
        self._done, self._at, self._worked, self._spent = done, time.monotonic(), 0.0, 0.0
        self._is_first, self._is_said = True, False

    def report(self, done: float) -> None:
        """Take how much is done by now."""
        now = time.monotonic()
        if done > self._done and now - self._at > QUICK:
            if not self._is_first:
                self._worked, self._spent = self._worked + done - self._done, self._spent + now - self._at
            self._is_first = False
        self._done, self._at = done, now

    def left(self, total: float) -> float | None:
        """Estimate the seconds that the rest will take; None before anything can be said, or after the end."""
        if self._spent < SOON or self._done >= total:
            return None
        return (total - self._done) * self._spent / self._worked

    def is_news(self) -> bool:
        """Tell, once, that the time left is known for the first time."""
        is_news = self._spent >= SOON and not self._is_said
        self._is_said = self._is_said or is_news
        return is_news

    def words(self, total: float | None) -> str:
        """Say about how long the rest takes; "" where nobody knows."""
        left = self.left(total) if total else None
        return "" if left is None else f", about {_minutes(left)} left"


class Counter:
    """Shows how far something counted is: a live bar in a terminal, else plain lines."""

    def __init__(self, label: str, unit: str, silent: bool = False) -> None:
        """unit: what is counted, for the line that says at the start how much there is to do."""
        columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[figures]}"))
        times = (TimeElapsedColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, *times, console=err, disable=silent or not err.is_terminal)
        self._task = self._bar.add_task(label, total=None, figures="")
        self._label, self._unit, self._silent = label, unit, silent
        self._total: int | None = None
        self._said = -PLAIN_EVERY
        self._pace = Pace()

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if not self._bar.disable:  # rich would write an empty line all the same
            self._bar.stop()

    def begin(self, done: int, total: int | None) -> None:
        """Say what there is to do from here on; what is done already took no time of ours."""
        self._total = total
        self._pace.begin(done)
        if total and not self._silent:
            announce(self._label, total - done, unit=self._unit)
            self._said = time.monotonic()

    def report(self, done: int, figures: str = "") -> None:
        """Say how much is done, now and then where there is no terminal; figures: what else there is to say."""
        self._bar.update(self._task, total=self._total, completed=done, figures=figures)
        self._pace.report(done)
        is_due = time.monotonic() - self._said >= PLAIN_EVERY or (figures and done == self._total)
        if not self._silent and not err.is_terminal and (self._pace.is_news() or is_due):
            self._said = time.monotonic()
            shown = f", {figures}" if figures else ""
            err.print(f"{self._label}: {done} of {self._total or '?'}{shown}{self._pace.words(self._total)}")


class TrainingProgress(Counter):
    """Takes a run's events ("start" with the number of steps, then one "step" each) and shows how it goes."""

    def __init__(self, silent: bool = False, label: str = "training") -> None:
        super().__init__(label, "updates", silent)
        self._success: float | None = None

    def __call__(self, event: dict) -> None:
        if event.get("type") in ("start", "resume"):
            self._success = None
            self.begin(event.get("step", 0), event.get("steps"))
        elif event.get("type") == "step":
            figures = f"loss {event['loss']:.3f}"
            if isinstance(event.get("success"), (int, float)):
                # One batch says little about success: show a running mean over about twenty.
                before = event["success"] if self._success is None else self._success
                self._success = 0.95 * before + 0.05 * event["success"]
                figures += f", success on its last images {self._success:.0%}"
            self.report(event["step"], figures)


@contextmanager
def counted(label: str, events: Path | None = None, unit: str = "images") -> Iterator[Callable[[int, int], None]]:
    """Yield `tell(done, total)`, which feeds a `Counter` and the lines of `events`.

    These are a run's (`core.events`): "start" with `steps`, the total, as soon as that is known, then "step" with
    `step`, what is done. Both have `time`, the seconds since. InputError: the file is there already.
    """
    from cloak_core.core.events import EventLog

    log: EventLog | None = None
    if events is not None:
        require_new(events)
        log = EventLog(events)
    begun = time.monotonic()
    known: int | None = None
    last = 0
    with Counter(label, unit) as counter, contextlib.closing(log) if log else contextlib.nullcontext():

        def tell(done: int, total: int) -> None:
            nonlocal known, last
            if (total != known or done < last) and total > 1:  # or other work of the same size
                counter.begin(done, total)
            counter.report(done)
            seconds = time.monotonic() - begun
            if log is not None and total != known:
                log.write({"type": "start", "step": 0, "time": seconds, "steps": total})
            if log is not None and done:
                log.write({"type": "step", "step": done, "time": seconds})
            known, last = total, done

        yield tell


@contextmanager
def shown_progress(store: RunStore) -> Iterator[None]:
    """Show how far every training and evaluation of a store is."""
    with TrainingProgress() as training, counted("evaluating") as images:
        store.on_event, store.on_images = training, images
        yield


class WorkProgress:
    """Takes what is being done, how much of all is done and how much there is in all; says so, and the time left."""

    def __init__(self) -> None:
        self._said, self._label, self._pace = -PLAIN_EVERY, "", Pace()

    def __call__(self, label: str, done: float, total: float) -> None:
        self._pace.report(done)
        if time.monotonic() - self._said >= PLAIN_EVERY or label != self._label:
            self._said, self._label = time.monotonic(), label
            err.print(f"{label}: {done / total:.0%}{self._pace.words(total)}")


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"
