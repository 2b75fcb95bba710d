# SPDX-License-Identifier: GPL-3.0-or-later
"""What run folders say about themselves: which there are, whether one is running, how far it is, how it ended.

Everything is read from the disk, so neither undo nor a crash of Blender can forget it. A run is running as long as
some process holds its lock file: that is true of trainers started by another Blender or in a terminal too, needs no
process number (which a container may hide), and ends with the process, however that ends.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..files.errors import InputError
from ..files.locks import is_held
from ..files.reading import parse_json, read_json
from ..poses.export import RECORD, read_export
from ..result.evaluations import SUMMARY, Evaluation, read_evaluation
from ..result.render_check import Verdict, last_verdicts
from ..session import session
from ..trainer import jobs
from ..trainer.progress import Progress, take_event
from .runs import COMMAND, input_folder, remembered_options, side_folder

RUNNING, DONE, STOPPED, FAILED = "running", "done", "stopped", "failed"
MOST_RUNS = 200
"""Of one folder, the latest."""
TAIL_BYTES = 64 << 10
"""Of an event log: some three hundred steps, more than the running mean of the success remembers."""


@dataclass(frozen=True)
class RunState:
    """One run as its folders tell it."""

    path: Path
    state: str
    """running, done, stopped or failed."""
    progress: Progress = field(default_factory=Progress)
    object: str = ""
    """Name of the body at export; "" of a run from the command line."""
    logo: str = ""
    detectors: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    """Of `cloak train`, as the add-on gave them; Resume repeats them."""
    unseen: dict[str, float] = field(default_factory=dict)
    """Of the run's evaluation, if there is one: worst success over the detectors by control ("logo", "clothing")."""
    evaluation: Evaluation | None = None
    """The same in full."""
    checks: tuple[Verdict, ...] = ()
    """Of its latest render check, by detector."""
    why: str = ""
    """Of a failed run: the reason in one line."""
    begun: float = 0.0
    """Seconds since the epoch: when it was started; two that run keep their places in the list."""

    @property
    def title(self) -> str:
        return self.path.name

    @property
    def exists(self) -> bool:
        """Whether there still is anything of it."""
        return self.path.is_dir() or input_folder(self.path).is_dir()

    @property
    def resumable(self) -> bool:
        """Whether Resume can go on: it has not reached its end, and the add-on knows what it was started with."""
        return self.state in (STOPPED, FAILED) and bool(self.options) and self.path.is_dir()


def find_runs(place: Path) -> list[Path]:
    """The runs in a folder, and those whose training never began: of these there is only the input."""
    found: dict[Path, float] = {}
    try:
        with os.scandir(place) as entries:
            for entry in entries:
                path = Path(entry.path)
                if entry.name.startswith(".") or not entry.is_dir(follow_symlinks=False):
                    continue
                if (path / "config.json").is_file() and (path / "logo.npy").is_file():
                    found[path] = entry.stat().st_mtime
                elif path.suffix == ".input" and (path / RECORD).is_file():
                    found.setdefault(path.with_suffix(""), entry.stat().st_mtime)
    except OSError:
        return []
    return sorted(found, key=found.__getitem__, reverse=True)[:MOST_RUNS]


def is_running(run: Path) -> bool:
    """Whether a trainer works in this folder, whoever started it."""
    if any(isinstance(job, jobs.TrainingJob) and job.active and job.run == run for job in session.jobs):
        return True  # not asked of the lock: a trainer that is just starting must not find it taken
    return is_held(run / ".lock")


_kept: dict[Path, tuple[tuple, RunState]] = {}


def read_state(run: Path) -> RunState:
    """What a run's folders say now. Files that did not change are not read again."""
    folder = input_folder(run)
    sources = (run / "config.json", run / "events.jsonl", run / SUMMARY, folder / "train.log")
    stamps = tuple(map(_stamp, (*sources, folder / COMMAND, run / "colors.npy")))
    kept = _kept.get(run)
    if kept is None or kept[0] != stamps:
        kept = _kept[run] = stamps, _read(run)
    state = replace(kept[1], checks=last_verdicts(side_folder(run)))
    return replace(state, state=RUNNING, why="") if is_running(run) else state


def _begun(run: Path) -> float:
    """When the export was written; of a run of the command line, when its settings were."""
    written = (input_folder(run) / RECORD, run / "logo.npy", run / "config.json")
    return next((path.stat().st_mtime for path in written if path.is_file()), 0.0)


def _stamp(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


def _read(run: Path) -> RunState:
    folder = input_folder(run)
    names = {}
    if (folder / RECORD).is_file():
        try:
            record = read_export(folder)
            names = {"object": record.object, "logo": record.logo, "options": tuple(remembered_options(run))}
        except InputError:
            names = {}  # half an input: the run can still be looked at, but not resumed
    progress, state, why = _read_events(run / "events.jsonl")
    if not run.is_dir():
        why = jobs.last_words(folder / "train.log") or "its training never began"
    elif not (run / "events.jsonl").exists() and (run / "colors.npy").is_file() and not names:
        state = DONE  # colours without a training's log, such as the zoo's
    elif state == FAILED and not why:
        why = f"its process ended without a word after step {progress.step}"
    found = {"detectors": _detectors(run / "config.json"), "unseen": _unseen(run / SUMMARY)}
    found["evaluation"] = read_evaluation(run)
    return RunState(run, state, progress, why=why, begun=_begun(run), **found, **names)


def _read_events(path: Path) -> tuple[Progress, str, str]:
    """Progress, state and reason by an event log that nobody writes to."""
    try:
        with path.open("rb") as file:
            head = file.read(TAIL_BYTES)
            start = max(len(head), path.stat().st_size - TAIL_BYTES)
            file.seek(start)
            tail = file.read(TAIL_BYTES)
    except OSError:
        return Progress(), FAILED, ""
    if len(head) < start:  # whole lines only
        head, tail = head[: head.rfind(b"\n") + 1], tail[tail.find(b"\n") + 1 :]
    progress, state, why = Progress(), FAILED, ""
    for line in (head + tail).splitlines():
        progress = take_event(progress, line)
        event = _parse(line)
        if event.get("type") == "end":
            state = DONE if event.get("outcome") == "done" else STOPPED
        elif event.get("type") == "error":
            state, why = FAILED, str(event.get("message", ""))[:200]
        elif event.get("type") in ("start", "resume", "step"):
            state, why = FAILED, ""
    return progress, state, why


def _parse(line: bytes) -> dict:
    try:
        return parse_json(line, "an event")
    except InputError:
        return {}


def _detectors(config: Path) -> tuple[str, ...]:
    try:
        return tuple(str(detector["spec"]) for detector in read_json(config)["detectors"])
    except (InputError, KeyError, TypeError):
        return ()


def _unseen(summary: Path) -> dict[str, float]:
    worst: dict[str, float] = {}
    try:
        for controls in read_json(summary)["detectors"].values():
            for name, rates in controls.items():
                if isinstance(rates, dict) and isinstance(rates.get("success"), (int, float)):
                    worst[name] = min(worst.get(name, 1.0), float(rates["success"]))
    except (InputError, KeyError, TypeError, AttributeError):
        return {}
    return worst


# --- following a trainer that this Blender did not start --------------------------------------------------------------


class FoundTrainer:
    """Stands for the process of a trainer that somebody else started: alive while it holds the run's lock."""

    def __init__(self, run: Path) -> None:
        self._run = run

    def poll(self) -> int | None:
        """None while it lives, then its exit code as far as the event log tells it."""
        if is_held(self._run / ".lock"):
            return None
        return {DONE: 0, STOPPED: jobs.STOPPED}.get(_read_events(self._run / "events.jsonl")[1], 1)

    def terminate(self) -> None:
        """Ask it to end after its current step."""
        request_stop(self._run)


def request_stop(run: Path) -> None:
    """Ask whoever trains in this folder to end in order. Raises `InputError` when nobody does."""
    if not is_running(run):
        raise InputError(f"{run.name} is not being trained")
    try:
        (run / "cancel").touch()
    except OSError as error:
        raise InputError(f"{run / 'cancel'}: cannot be written ({error.strerror})") from None
