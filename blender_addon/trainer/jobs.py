# SPDX-License-Identifier: GPL-3.0-or-later
"""Work done outside Blender: processes that a timer looks in on.

Blender itself never waits: the timer's function (`tick`) takes what has arrived and returns. In each lane one job runs
at a time, others wait their turn: trainings and what follows them in one, checks of detectors in another.
Standard output and error go to files, so a trainer never blocks on a full pipe and its last words can be read.
"""

import contextlib
import math
import os
import subprocess
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import bpy

from ..files.errors import InputError
from ..session import session
from ..ui.window import between_strokes, end_notice, redraw, tell_status
from .program import cloak_command, start_process, trainer
from .progress import Progress, duration, read_events

TICK_SECONDS = 0.25
NOTICE_SECONDS = 10.0  # for which the status bar says how a job ended that no panel shows
STOPPED = 3  # exit code of a trainer that was stopped, with a valid checkpoint
OnEnd = Callable[["Job"], str | None] | None
"""Called when a job has ended, successfully or not. It may return a message; an `InputError` fails the job."""


class Job:
    """Commands that run one after the other outside Blender; `poll` moves it on.

    `state` is "waiting" or "running", then "done", "stopped" or "failed"; `message` says the reason in one line.
    commands: lists of words. events: the commands' progress log, if they keep one.
    """

    lane = ""
    appends = False  # whether its log of events goes on with an earlier one

    def __init__(
        self, label: str, commands: Sequence, folder: Path, name: str, on_end: OnEnd = None, events: Path | None = None
    ) -> None:
        self.label, self.state, self.message = label, "waiting", ""
        self.notice = ""  # warning to show while it runs
        self.is_bad_news = False  # the job succeeded, but its result is a failure
        self.code: int | None = None
        self.outputs: list[str] = []
        self.progress = Progress()
        self.on_tick: Callable[[Job], None] | None = None  # called at every look while it runs: live colours
        self.on_end, self._commands, self._process = on_end, list(commands), None
        self.log = folder / f"{name}.log"  # what the commands said on standard error
        self._out = folder / f"{name}.out"
        self._events, self._cancelled, self._begun = events, False, 0.0

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
        return self.progress.fraction if self._events else len(self.outputs) / max(1, len(self._commands))

    def describe(self) -> str:
        """One line for the panel."""
        if self.state == "waiting":
            return f"Waits for {session.first_in(self.lane).label}"
        if not self.running:
            return self.message
        of = f" {len(self.outputs) + 1}/{len(self._commands)}" if len(self._commands) > 1 else ""
        if self._cancelled:
            return f"{self.label}{of} (stopping)"
        if not self._events:
            return f"{self.label}{of}, {duration(time.monotonic() - self._begun)}"
        return f"{self.label} {self.progress.describe()}" if self.progress.steps else f"{self.label}: preparing..."

    def start(self) -> "Job":
        """Start its next command; raises `InputError` where that cannot be."""
        self._process = self._process or self._start(self._commands[len(self.outputs)])
        self._begun = time.monotonic() if self.state == "waiting" else self._begun
        self.state = "running"
        return self

    def start_or_fail(self) -> None:
        """Start it; where that cannot be, it has failed."""
        try:
            self.start()
        except Exception as error:
            self._finish("failed", self.reason(error))

    def _start(self, command: list[str]) -> subprocess.Popen:
        if self._events is not None and not self.appends:
            self._events.unlink(missing_ok=True)
        # Ctrl-C in Blender's terminal is ours to pass on.
        options = {"stdin": subprocess.DEVNULL, "start_new_session": os.name == "posix"}
        return start_process(command, self._out, self.log, **options)

    def poll(self) -> bool:
        """Look in on the process; True while there is more to wait for."""
        if not self.running:
            return False
        code = self.code = self._process.poll()
        self.read_progress()
        if code is None:
            return True
        # A trainer that somebody else started has said nothing here.
        self.outputs.append(self._out.read_text("utf-8", "replace") if self._out.is_file() else "")
        if code == 0 and not self._cancelled and len(self.outputs) < len(self._commands):
            self._process = None
            self.start_or_fail()
            return self.running
        self._finish(*self._verdict(code))
        return False

    def read_progress(self) -> None:
        """Read how far it is from its log of events, where it runs and has one."""
        if self.running and self._events is not None:
            self.progress = read_events(self._events)

    def _verdict(self, code: int) -> tuple[str, str]:
        if code == STOPPED or (self._cancelled and code != 0):
            return "stopped", f"{self.label} stopped"
        if code == 0:
            return "done", f"{self.label} done"
        words = last_words(self.log)
        if code == 2:
            return "failed", words or f"{self.label}: the trainer refused its input"
        if code < 0:
            return "failed", f"{self.label}: the process was killed (signal {-code})"
        return "failed", f"{self.label} failed (exit code {code}): {words or 'no message'}"

    def _finish(self, state: str, message: str) -> None:
        self.state, self.message = state, message
        if self.on_end is not None:
            try:
                self.message = self.on_end(self) or self.message
            except Exception as error:
                self.state, self.message = "failed", self.reason(error)

    def reason(self, error: Exception) -> str:
        """One line on what went wrong, for the panel; of a defect its traceback goes into the log."""
        if isinstance(error, InputError):
            return str(error)
        with contextlib.suppress(OSError), self.log.open("a", encoding="utf-8") as log:
            traceback.print_exception(error, file=log)
        return f"{self.label}: a defect of the add-on ({type(error).__name__}: {error}); see {self.log}"

    def look(self) -> None:
        """`poll` and `on_tick` for the timer: whatever goes wrong is shown, and is the end of this job at most."""
        try:
            self.poll()
        except Exception as error:
            self.cancel()
            self._finish("failed", self.reason(error))
        try:
            if self.on_tick is not None:
                self.on_tick(self)
        except Exception as error:
            self.notice = self.reason(error)

    def cancel(self) -> None:
        """Ask the process to stop, which may take a moment; a queued job stops at once."""
        self._cancelled = True
        if self.running:
            self._terminate()
        elif self.state == "waiting":
            self._finish("stopped", f"{self.label} stopped")

    def _terminate(self) -> None:
        with contextlib.suppress(OSError):
            self._process.terminate()

    def abandon(self) -> None:
        """Blender is closing: ask the process to end, and wait no longer than a blink."""
        self.on_end = None
        self.cancel()

    def wait(self, seconds: float = math.inf) -> "Job":
        """Block until the job has ended: for headless use and tests."""
        until = time.monotonic() + seconds
        if self.state == "waiting":
            self.start()
        while self.poll() and time.monotonic() < until:
            time.sleep(0.02)
        return self


class TrainingJob(Job):
    """One `cloak train` and its run folder: started by `command`, or found running as `process`.

    process: it needs the method `poll` of `subprocess.Popen`. It goes on when this Blender closes.
    """

    appends = True

    def __init__(self, command: list[str], run: Path, folder: Path, process: object = None) -> None:
        super().__init__("Training", [command], folder, "train", None, run / "events.jsonl")
        self.run, self.is_ours, self._process = run, process is None, process

    def _start(self, command: list[str]) -> subprocess.Popen:
        with contextlib.suppress(OSError):
            (self.run / "cancel").unlink()  # meant for an earlier process that ended while it was asked again
        return super()._start(command)

    def poll(self) -> bool:
        if self.running and self._cancelled:
            self._terminate()  # again: a trainer that is just opening its run folder sweeps old requests away
        return super().poll()

    def abandon(self) -> None:
        if not self.is_ours:
            return
        super().abandon()
        if self.running:
            super()._terminate()

    def _terminate(self) -> None:
        if self.is_ours and not self.run.is_dir():
            super()._terminate()  # nothing to save yet
            return
        with contextlib.suppress(OSError):
            (self.run / "cancel").touch()

    def _verdict(self, code: int) -> tuple[str, str]:
        if self.is_ours or self._cancelled or code in (0, STOPPED):
            return super()._verdict(code)
        # Whoever started it was told its exit code.
        return "failed", self.progress.why or f"Training ended without a word after step {self.progress.step}"

    def _finish(self, state: str, message: str) -> None:
        if state == "done":
            message = f"Training done: {self.progress.describe()}, {self.progress.figures()}"
        elif state == "stopped":
            message = f"Stopped at step {self.progress.step}: Resume goes on from there"
        elif self.progress.step:
            message += "; Resume goes on from the last checkpoint"
        super()._finish(state, message)


def last_words(log: Path) -> str:
    """The last line of a log, without the program's name."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 8192))
            lines = [line.strip() for line in file.read().decode("utf-8", "replace").splitlines() if line.strip()]
    except OSError:
        return ""
    return lines[-1].removeprefix("cloak: ")[:300] if lines else ""


# --- the jobs of this Blender: one of each lane runs, the others wait their turn --------------------------------------


def launch(job: Job) -> Job:
    """Start the job or queue it; the timer polls it. Raises `InputError`."""
    if session.first_in(job.lane) is None:
        job.start()
    session.jobs = [old for old in session.jobs if old.active or old.label != job.label]
    session.jobs.append(job)
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TICK_SECONDS, persistent=True)
    return job


def run_cloak(label: str, words: Iterable, folder: Path, name: str, on_done: OnEnd, follow: bool = False) -> str:
    """Launch one command of the trainer, `cloak WORDS...`; with `follow` it logs its progress into the folder.

    on_done: called when it has succeeded; may return a message. Returns what its launcher adds to its own message:
    ", after Training" where it waits its turn.
    """
    events = folder / f"{name}.jsonl" if follow else None
    command = cloak_command(trainer(), *words, *(["--events", events] if events else []))
    on_end = lambda job: on_done(job) if job.state == "done" else None
    return waits(launch(Job(label, [command], folder, name, on_end, events)))


def waits(job: Job) -> str:
    """Return ", after Training" for a queued job, to be added to a message."""
    return f", after {session.first_in(job.lane).label}" if job.state == "waiting" else ""


def _follow() -> None:
    for job in session.jobs:
        job.read_progress()
    redraw(panels_alone=True)


@between_strokes(TICK_SECONDS, meanwhile=_follow)
def tick() -> float | None:
    """The timer's function: seconds until it wants to be called again, None when all jobs have ended."""
    unseen = not session.panel_seen
    for job in [job for job in session.jobs if job.running]:
        job.look()
        if not job.active and unseen:
            tell_status(job.message)  # a popup at the mouse would take the next click
            bpy.app.timers.register(end_notice, first_interval=NOTICE_SECONDS)
        session.panel_seen = False
        redraw(panels_alone=True)  # four times a second: the viewport follows by itself when colours come
    for job in [job for job in session.jobs if job.state == "waiting"]:
        if session.first_in(job.lane) is job:
            job.start_or_fail()
    return TICK_SECONDS if any(job.active for job in session.jobs) else None


def shut_down() -> None:
    """End all jobs that Blender started: the add-on is being disabled, or Blender is closing. Others go on."""
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    for job in session.jobs:
        if job.running:
            job.abandon()
    session.jobs = []
