"""A training's progress: a live bar in a terminal, plain lines in a pipe; standard error either way."""

from __future__ import annotations

import time
from types import TracebackType

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cloak_core.commands.base import err

PLAIN_EVERY = 10.0
"""Seconds between lines where there is no terminal."""


class TrainingProgress:
    """Takes a run's events ("start" with the number of steps, then one "step" each) and shows how it goes."""

    def __init__(self, silent: bool = False) -> None:
        self._bar: Progress | None = None
        self._silent = silent
        if err.is_terminal and not silent:
            columns = [
                TextColumn("training"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[figures]}"),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
            ]
            self._bar = Progress(*columns, console=err)
            self._task = self._bar.add_task("training", total=None, figures="")
        self._total: int | None = None
        self._said = -PLAIN_EVERY
        self._success: float | None = None

    def __enter__(self) -> TrainingProgress:
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if self._bar:
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
        if self._bar:
            self._bar.update(self._task, total=self._total, completed=event["step"], figures=figures)
        elif time.monotonic() - self._said >= PLAIN_EVERY or event["step"] == self._total:
            self._said = time.monotonic()
            err.print(f"step {event['step']}/{self._total or '?'}  {figures}  {event['time']:.0f} s")
