# SPDX-License-Identifier: GPL-3.0-or-later
"""Work done outside Blender: a process, a thread that reads its events, and a timer that looks in on both.

Blender itself never waits: the timer's function (`tick`) takes what has arrived and returns. One job runs at a time,
others wait their turn.
Standard output and error go to files, so a trainer never blocks on a full pipe and its last words can be read.
"""

from __future__ import annotations

import contextlib
import math
import os
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import bpy

from ..files.errors import InputError
from ..session import session
from ..ui.window import redraw
from .progress import Progress, take_event
from .python import clean_environment, no_window

TICK_SECONDS = 0.25
READ_SECONDS = 0.1
MAX_LINE = 1 << 20
STOPPED = 3
"""Exit code of a trainer that ended early but in order."""


# --- one or several commands, one after the other ---------------------------------------------------------------------


OnEnd = Callable[["Job"], str | None]
"""Called when a job has ended, in whatever way. It may return another message; an `InputError` fails the job."""


class Process(Protocol):
    """What a job asks of its process; `subprocess.Popen` has it."""

    def poll(self) -> int | None:
        """The exit code, None while it runs."""

    def terminate(self) -> None:
        """Ask it to end."""


class Job:
    """Commands that run one after the other outside Blender; `poll` moves it on.

    `state` is "running", then "done", "stopped" or "failed"; `message` says the reason in one line.
    """

    def __init__(
        self,
        label: str,
        commands: Sequence[list[str]],
        folder: Path,
        name: str,
        on_end: OnEnd | None = None,
        process: Process | None = None,
    ) -> None:
        self.label = label
        self.state = "waiting"
        self.message = ""
        self.notice = ""
        """What should be known at once, while it runs."""
        self.is_bad_news = False
        """It ended as it should, but what it found out is no success."""
        self.code: int | None = None
        self.outputs: list[str] = []
        self._on_end = on_end
        self._commands = list(commands)
        self._files = (folder / f"{name}.out", folder / f"{name}.log")
        self._cancelled = False
        self._process = process
        self.on_tick: Callable[[Job], None] | None = None
        """Called at every look while it runs: live colours."""

    def start(self) -> Job:
        """Start its first command; raises `InputError` where that cannot be."""
        self._process = self._process or self._start(self._commands[0])
        self.state = "running"
        return self

    def start_or_fail(self) -> None:
        """Start it; where that cannot be, it has failed."""
        try:
            self.start()
        except InputError as error:
            self._finish("failed", str(error))

    @property
    def log(self) -> Path:
        """What the commands said on standard error."""
        return self._files[1]

    @property
    def running(self) -> bool:
        return self.state == "running"

    @property
    def active(self) -> bool:
        """Whether it runs or waits its turn."""
        return self.state in ("running", "waiting")

    @property
    def fraction(self) -> float:
        """How much is done, 0 to 1."""
        return len(self.outputs) / max(1, len(self._commands))

    def describe(self) -> str:
        """One line for the panel."""
        if self.state == "waiting":
            return f"Waits for {session.job.label}"
        if not self.running:
            return self.message
        of = f" {len(self.outputs) + 1}/{len(self._commands)}" if len(self._commands) > 1 else ""
        return f"{self.label}{of}{' (stopping)' if self._cancelled else ''}"

    def _start(self, command: list[str]) -> subprocess.Popen:
        from .preferences import through  # which looks after jobs of its own

        try:
            with self._files[0].open("wb") as out, self._files[1].open("ab") as log:
                return subprocess.Popen(
                    through(command),
                    stdout=out,
                    stderr=log,
                    stdin=subprocess.DEVNULL,
                    cwd=self._files[0].parent,
                    env=clean_environment(),
                    start_new_session=os.name == "posix",  # Ctrl-C in Blender's terminal is ours to pass on
                    **no_window(),
                )
        except OSError as error:
            raise InputError(f"{error.filename or command[0]}: cannot be started ({error.strerror})") from None

    def poll(self) -> bool:
        """Look in on the process; True while there is more to wait for."""
        if not self.running:
            return False
        code = self.code = self._process.poll()
        if code is None:
            return True
        self.outputs.append(self._said())
        if code == 0 and not self._cancelled and len(self.outputs) < len(self._commands):
            try:
                self._process = self._start(self._commands[len(self.outputs)])
                return True
            except InputError as error:
                self._finish("failed", str(error))
                return False
        self._finish(*self._verdict(code))
        return False

    def _said(self) -> str:
        """What the command that has ended said on standard output."""
        try:
            return self._files[0].read_text("utf-8", "replace")
        except FileNotFoundError:  # a trainer that somebody else started
            return ""

    def _verdict(self, code: int) -> tuple[str, str]:
        if code == STOPPED or (self._cancelled and code != 0):
            return "stopped", f"{self.label} stopped"
        if code == 0:
            return "done", f"{self.label} done"
        said = last_words(self.log)
        if code == 2:
            return "failed", said or f"{self.label}: the trainer refused its input"
        if code < 0:
            return "failed", f"{self.label}: the process was killed (signal {-code})"
        return "failed", f"{self.label} failed (exit code {code}): {said or 'no message'}"

    def _finish(self, state: str, message: str) -> None:
        self.state, self.message = state, message
        if self._on_end is not None:
            try:
                self.message = self._on_end(self) or message
            except InputError as error:
                self.state, self.message = "failed", str(error)

    def cancel(self) -> None:
        """Ask the process to end, which may take a moment; one that waits has ended at once."""
        self._cancelled = True
        if self.running:
            self._ask_to_stop()
        elif self.state == "waiting":
            self._finish("stopped", f"{self.label} stopped")

    def _ask_to_stop(self) -> None:
        self._terminate()

    def _terminate(self) -> None:
        with contextlib.suppress(OSError):
            self._process.terminate()

    def abandon(self) -> None:
        """Blender is closing: ask the process to end, and wait no longer than a blink."""
        self._on_end = None
        self.cancel()

    def wait(self, seconds: float = math.inf) -> Job:
        """Block until the job has ended: for headless use and tests."""
        until = time.monotonic() + seconds
        if self.state == "waiting":
            self.start()
        while self.poll() and time.monotonic() < until:
            time.sleep(0.02)
        return self


def last_words(log: Path) -> str:
    """The last line of a log, without the program's name."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 8192))
            lines = [line.strip() for line in file.read().decode("utf-8", "replace").splitlines() if line.strip()]
    except OSError:
        return ""
    return lines[-1].removeprefix("cloak: ")[:300] if lines else ""


# --- work that tells how far it is ------------------------------------------------------------------------------------


class FollowedJob(Job):
    """One command that logs events: `cloak train` does, and `cloak evaluate`, `film`, `logo heatmap` with --events."""

    def __init__(
        self,
        label: str,
        commands: Sequence[list[str]],
        folder: Path,
        name: str,
        events: Path,
        on_end: OnEnd | None = None,
        process: Process | None = None,
    ) -> None:
        self.progress = Progress()
        self._events = events
        self._ended = threading.Event()
        super().__init__(label, commands, folder, name, on_end, process)
        self._reader = threading.Thread(target=self._read_events, name="cloak events", daemon=True)

    def start(self) -> Job:
        super().start()
        self._reader.start()
        return self

    @property
    def fraction(self) -> float:
        return self.progress.fraction

    def describe(self) -> str:
        if not self.running:
            return super().describe()
        if self._cancelled:
            return f"{self.label} (stopping)"
        return f"{self.label} {self.progress.describe()}" if self.progress.steps else f"{self.label}: preparing..."

    def abandon(self) -> None:
        self._ended.set()
        super().abandon()

    def _finish(self, state: str, message: str) -> None:
        self._end_reading()
        super()._finish(state, message)

    def _end_reading(self) -> None:
        self._ended.set()
        if self._reader.is_alive():
            self._reader.join(timeout=5)

    def _read_events(self) -> None:
        """Follow the events from their start. The thread only replaces `progress`, a frozen record."""
        path, position, pending = self._events, 0, b""
        while True:
            last_round = self._ended.is_set()
            with contextlib.suppress(OSError), path.open("rb") as file:
                if path.stat().st_size < position:  # a resumed run rewinds its log
                    position, pending = 0, b""
                file.seek(position)
                chunk = file.read()
                position += len(chunk)
                *lines, pending = (pending + chunk).split(b"\n")
                for line in lines:
                    self.progress = take_event(self.progress, line)
                if len(pending) > MAX_LINE:
                    pending = b""
            if last_round:
                return
            self._ended.wait(READ_SECONDS)


class TrainingJob(FollowedJob):
    """One `cloak train` and its run folder: started by `command`, or found running as `process`."""

    def __init__(
        self, command: list[str], run: Path, folder: Path, on_end: OnEnd | None = None, process: Process | None = None
    ) -> None:
        self.run = run
        self.is_ours = process is None
        """Blender ends the trainers it started when it closes; it only takes its eyes off those it found."""
        super().__init__("Training", [command], folder, "train", run / "events.jsonl", on_end, process)

    def describe(self) -> str:
        if not self.running:
            return super().describe()
        if self._cancelled:
            return "Stopping after this step..."
        return self.progress.describe() if self.progress.steps else "Preparing..."

    def poll(self) -> bool:
        if self.running and self._cancelled:
            self._ask_to_stop()  # again: a trainer that is just opening its run folder sweeps old requests away
        return super().poll()

    def abandon(self) -> None:
        self._ended.set()
        if not self.is_ours:
            return
        super().abandon()
        if self.running:
            self._terminate()

    def _ask_to_stop(self) -> None:
        if not self.run.is_dir():
            self._terminate()  # nothing to save yet
            return
        with contextlib.suppress(OSError):
            (self.run / "cancel").touch()

    def _finish(self, state: str, message: str) -> None:
        self._end_reading()  # the last events belong into the message
        if state == "done":
            message = f"Training done: {self.progress.describe()}, {self.progress.figures()}"
        elif state == "stopped":
            message = f"Stopped at step {self.progress.step}: Resume goes on from there"
        elif self.progress.step:
            message += "; Resume goes on from the last checkpoint"
        super()._finish(state, message)


# --- the jobs of this Blender: one runs, the others wait their turn ---------------------------------------------------


def busy() -> str:
    """Why nothing may start now that cannot wait its turn; "" when it may."""
    job = session.job
    return f"{job.label} is running: wait for it, or cancel it" if job is not None and job.active else ""


def require_idle() -> None:
    """Raise `InputError` while a job runs."""
    if busy():
        raise InputError(busy())


def launch(job: Job) -> Job:
    """Start the job, or let it wait for those before it; the timer looks after both. Raises `InputError`."""
    ahead = session.job
    if ahead is None or not ahead.active:
        job.start()
    session.jobs = [old for old in session.jobs if old.active or old.label != job.label]
    session.jobs.append(job)
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TICK_SECONDS, persistent=True)
    return job


def run_command(label: str, command: list[str], folder: Path, name: str, on_end: OnEnd, follow: str = "") -> str:
    """Launch a job of one command; `follow` is the file in `folder` that its events go to.

    Returns what its launcher adds to its message: ", after Training" where it waits its turn.
    """
    if follow:
        (folder / follow).unlink(missing_ok=True)
        return waits(launch(FollowedJob(label, [command], folder, name, folder / follow, on_end)))
    return waits(launch(Job(label, [command], folder, name, on_end)))


def waits(job: Job) -> str:
    """ ", after Training" for a job that waits its turn, for the message of who launched it."""
    return f", after {session.job.label}" if job.state == "waiting" else ""


def tick() -> float | None:
    """The timer's function: seconds until it wants to be called again, None when all jobs have ended."""
    job = session.job
    if job is not None and job.running:
        job.poll()
        if job.on_tick is not None:
            job.on_tick(job)
        redraw(panels_alone=True)  # four times a second: the viewport follows by itself when colours come
    _start_next()
    return TICK_SECONDS if session.job is not None and session.job.active else None


def _start_next() -> None:
    """Start the next waiting job, if none runs; a job that cannot be started has failed."""
    for job in [job for job in session.jobs if job.state == "waiting"]:
        if session.job.running:
            return
        job.start_or_fail()


def shut_down() -> None:
    """The add-on is going (or Blender is closing): end the job in order and forget it."""
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    forget()


def forget() -> None:
    """Let go of all jobs: what Blender started ends in order, a training that it found goes on."""
    for job in session.jobs:
        if job.running:
            job.abandon()
    session.jobs = []
