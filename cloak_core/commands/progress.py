"""How far a training or another long command is.

A live bar in a terminal, plain lines in a pipe, on standard error either way; a file of events for programs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cloak_core.commands.base import err, require_new

if TYPE_CHECKING:
    from cloak_core.studies.store import RunStore

PLAIN_EVERY = 10.0
"""Seconds between lines where there is no terminal."""
SOON = 2.0
"""Seconds after which the first line says about how long it takes, in a terminal, too."""


def announce(work: str, total: int, seconds: float | None = None, *, unit: str) -> None:
    """Say at the start of long work what there is to do, and about how long it takes where that is known.

    work: what is done; total, unit: how much of what. What is known later, `Pace` says.
    """
    about = "" if seconds is None else f", about {_minutes(seconds)} on this machine"
    err.print(f"{work}: {total:,} {unit.removesuffix('s') if total == 1 else unit}{about}")


class TrainingProgress:
    """Takes a run's events ("start" with the number of steps, then one "step" each) and shows how it goes."""

    def __init__(self, silent: bool = False, label: str = "training") -> None:
        columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[figures]}"))
        times = (TimeElapsedColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, *times, console=err, disable=silent or not err.is_terminal)
        self._task = self._bar.add_task(label, total=None, figures="")
        self._silent, self._label = silent, label
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
            self._total, self._success = event.get("steps"), None
            self._pace.begin(event.get("step", 0))
            if self._total:
                announce(self._label, self._total - event.get("step", 0), unit="updates")
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
        pace = self._pace.words(event["step"], self._total)
        due = time.monotonic() - self._said >= PLAIN_EVERY or event["step"] == self._total
        if not err.is_terminal and (due or self._pace.is_news):
            self._said = time.monotonic()
            err.print(f"step {event['step']}/{self._total or '?'}  {figures}  {event['time']:.0f} s{pace}")


class Pace:
    """How quick something counted goes, from the first that was done: what is compiled for it counts for nothing."""

    def __init__(self) -> None:
        self.begin(0)

    def begin(self, done: int) -> None:
        """Count from here: what is done already took no time of ours."""
        self._first, self._began = done, None
        self._told = self.is_news = False
        """`is_news`: `words` says for the first time how long it takes."""

    def words(self, done: int, total: int | None) -> str:
        """Say the rate and about how long the rest takes; "" before anything can be said, or after the end."""
        if self._began is None and done > self._first:
            self._first, self._began = done, time.monotonic()
        if self._began is None:
            return ""
        worked, seconds = done - self._first, time.monotonic() - self._began
        self.is_news = not self._told and worked > 0 and seconds >= SOON
        self._told = self._told or self.is_news
        if worked <= 0 or seconds <= 0 or not total or done >= total:
            return ""
        rate = worked / seconds
        shown = f"{rate:.1f} a second" if rate >= 1 else f"{1 / rate:.1f} s each"
        return f"; {shown}, about {_minutes((total - done) / rate)} left"


@contextmanager
def counted(label: str, events: Path | None = None, unit: str = "images") -> Iterator[Callable[[int, int], None]]:
    """Yield `tell(done, total)`, which feeds a bar in a terminal and the lines of `events`.

    The first says what there is to do, in `unit`; as soon as some of it is done, a line says about how long it takes.

    These are a run's (`core.events`): "start" with `steps`, the total, as soon as that is known, then "step" with
    `step`, what is done. Both have `time`, the seconds since. InputError: the file is there already.
    """
    from cloak_core.core.events import EventLog

    log = None
    if events is not None:
        require_new(events)
        log = EventLog(events)
    begun = time.monotonic()
    known: int | None = None
    last = 0
    pace, said = Pace(), begun
    columns = (*Progress.get_default_columns(), MofNCompleteColumn())
    with Progress(*columns, console=err, disable=not err.is_terminal) as bar:
        task = bar.add_task(label, total=None)

        def tell(done: int, total: int) -> None:
            nonlocal known, said, last
            bar.update(task, completed=done, total=total)
            if (total != known or done < last) and total > 1:  # or other work of the same size
                pace.begin(done)
                announce(label, total, unit=unit)
                said = time.monotonic()
            last = done
            words = pace.words(done, total)
            if not err.is_terminal and (pace.is_news or time.monotonic() - said >= PLAIN_EVERY):
                said = time.monotonic()
                err.print(f"{label}: {done} of {total}{words}")
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


@contextmanager
def shown_progress(store: RunStore) -> Iterator[None]:
    """Show how far every training and evaluation of a store is."""
    with TrainingProgress() as training, counted("evaluating") as images:
        store.on_event, store.on_images = training, images
        yield


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
            left = f", about {_minutes(self.left(total))} left" if self._worked >= TELLING * total else ""
            err.print(f"{label}: {done / total:.0%}{left}")

    def left(self, total: float) -> float:
        """Estimate the seconds that the rest will take at the pace so far."""
        return (total - self._done) * self._spent / max(self._worked, 1e-9)


TELLING = 0.01
"""Share of the work that says how long the rest takes; the first images wait for compilers and files."""
QUICK = 0.002
"""Seconds; a report that comes sooner is of something that was done before."""


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"
