"""How far a training or another long command is.

A live bar in a terminal, plain lines in a pipe, on standard error either way; a file of events for programs, and
TensorBoard's files, where they are asked for.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cloak_core.commands.base import err, require_new
from cloak_core.core.pictures import read_picture
from cloak_core.files.errors import InputError

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
            figures += f"  success {self._success:.0%}"
        self._bar.update(self._task, total=self._total, completed=event["step"], figures=figures)
        if not err.is_terminal and (time.monotonic() - self._said >= PLAIN_EVERY or event["step"] == self._total):
            self._said = time.monotonic()
            err.print(f"step {event['step']}/{self._total or '?'}  {figures}  {event['time']:.0f} s")


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
    with Progress(console=err, disable=not err.is_terminal) as bar:
        task = bar.add_task(label, total=None)

        def tell(done: int, total: int) -> None:
            nonlocal known
            bar.update(task, completed=done, total=total)
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


SHOWN = {"step": "training", "held_out": "held out"}
"""Events whose numbers become scalars, and the group they stand in."""


class TensorBoardEvents:
    """Takes a run's events and writes them into RUN/tensorboard. InputError where the package is not installed."""

    def __init__(self, run: Path) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            raise InputError("--tensorboard: needs TensorBoard: pip install 'cloak-core[tensorboard]'") from None
        self._writer_type = SummaryWriter
        self._run = run
        self._writer: SummaryWriter | None = None

    def __enter__(self) -> TensorBoardEvents:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if self._writer:
            self._writer.close()

    def __call__(self, event: dict) -> None:
        kind, step = event.get("type"), event["step"]
        if kind in ("start", "resume"):
            # Only now does the run folder exist. What an earlier part wrote of later steps is hidden.
            self._writer = self._writer_type(str(self._run / "tensorboard"), purge_step=step + 1)
        if self._writer is None:
            return
        if kind in SHOWN:
            for name, value in event.items():
                if isinstance(value, float) and name != "time":
                    self._writer.add_scalar(f"{SHOWN[kind]}/{name}", value, step)
        elif kind == "preview":
            self._add_picture(self._run / event["path"], step)

    def _add_picture(self, path: Path, step: int) -> None:
        self._writer.add_image("preview", read_picture(path), step, dataformats="HWC")
