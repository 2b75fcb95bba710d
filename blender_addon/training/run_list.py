# SPDX-License-Identifier: GPL-3.0-or-later
"""The runs in the output folder, beside the .blend file, and on objects: what their folders say, and the panel's list.

Everything is read from the disk, so neither undo nor a crash of Blender can forget it. A run is running as long as some
process holds its lock file: that is true of trainers started by another Blender or in a terminal too, needs no process
number (which a container may hide), and ends with the process. The list lives on the window manager, which undo leaves
alone, and is read again every other second while the panel is being looked at.
"""

import contextlib
import logging
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.props import CollectionProperty, PointerProperty

from ..blender.blend_paths import blend_folder, portable
from ..body.garments import is_dressed
from ..body.objects import active_body, body_reason
from ..files.errors import InputError
from ..files.reading import read_json
from ..files.writing import is_held
from ..poses.export import RECORD
from ..properties import output_folder
from ..result.evaluations import SUMMARY, Evaluation, Sight, read_evaluation
from ..result.render_check import last_check
from ..session import session
from ..trainer import jobs
from ..trainer.progress import Progress, read_events
from ..ui import props
from ..ui.window import between_strokes, redraw
from .runs import COMMAND, export_of, import_colors, input_folder, remembered_options, run_of, side_folder

LOG = logging.getLogger(__name__)
REFRESH_SECONDS = 2.0
WATCHED_SECONDS = 5.0  # the list is refreshed for this long after it was last drawn
RUNNING, DONE, STOPPED, FAILED = "running", "done", "stopped", "failed"
MOST_RUNS = 200  # of one folder, the latest


@dataclass(frozen=True)
class RunState:
    """State of one run, read from its folders."""

    path: Path
    state: str  # running, done, stopped or failed
    progress: Progress = field(default_factory=Progress)
    object: str = ""  # name of the body at export; "" of a run from the command line
    logo: str = ""
    detectors: tuple[str, ...] = ()
    options: tuple[str, ...] = ()  # of `cloak train`, as the add-on gave them; Resume repeats them
    evaluation: Evaluation | None = None
    checks: tuple[Sight, ...] = ()  # of its latest render check
    why: str = ""  # of a failed run: the reason in one line
    begun: float = 0.0  # seconds since the epoch: when it was started; two that run keep their places in the list

    @property
    def title(self) -> str:
        return self.path.name

    @property
    def unseen(self) -> dict[str, float]:
        """Worst success over the detectors of its evaluation, by control ("logo", "clothing")."""
        return self.evaluation.worst() if self.evaluation else {}


def find_runs(place: Path) -> list[Path]:
    """Find the runs in a folder, with runs that only have an input because their training never began."""
    begun = {file.parent.with_suffix(""): file.parent for file in place.glob(f"*.input/{RECORD}")}
    ready = {file.parent: file.parent for file in place.glob("*/config.json") if file.with_name("logo.npy").is_file()}
    folders = {run: folder for run, folder in (begun | ready).items() if not folder.is_symlink()}
    shown = [run for run in folders if not run.name.startswith(".")]
    return sorted(shown, key=lambda run: _stamp(folders[run]), reverse=True)[:MOST_RUNS]


_kept: dict[Path, tuple[tuple, RunState]] = {}


def read_state(run: Path) -> RunState:
    """What a run's folders say now. Files that did not change are not read again."""
    folder = input_folder(run)
    sources = (run / "config.json", run / "events.jsonl", run / SUMMARY, folder / "train.log")
    stamps = tuple(map(_stamp, (*sources, folder / COMMAND, run / "colors.npy")))
    kept = _kept.get(run)
    if kept is None or kept[0] != stamps:
        kept = _kept[run] = stamps, _read(run)
    state = replace(kept[1], checks=last_check(side_folder(run)))
    # The lock is not asked while a trainer of ours is just starting: it must not find it taken.
    runs_now = session.training_of(run) is not None or is_held(run / ".lock")
    return replace(state, state=RUNNING, why="") if runs_now else state


def _stamp(path: Path) -> tuple[int, int]:
    with contextlib.suppress(OSError):
        status = path.stat()
        return status.st_mtime_ns, status.st_size
    return 0, 0


def _read(run: Path) -> RunState:
    folder = input_folder(run)
    names = {}
    with contextlib.suppress(InputError):  # half an input: the run can still be looked at, but not resumed
        if done := export_of(run):
            names = {"object": done.object, "logo": done.logo, "options": tuple(remembered_options(run))}
    progress = read_events(run / "events.jsonl")
    state, why = progress.outcome or FAILED, progress.why
    if not run.is_dir():
        why = jobs.last_words(folder / "train.log") or "its training never began"
    elif not (run / "events.jsonl").exists() and (run / "colors.npy").is_file() and not names:
        state = DONE  # colours without a training's log, such as the zoo's
    elif state == FAILED and not why:
        why = f"its process ended without a word after step {progress.step}"
    detectors: tuple[str, ...] = ()
    with contextlib.suppress(InputError, KeyError, TypeError):
        detectors = tuple(str(detector["spec"]) for detector in read_json(run / "config.json")["detectors"])
    # It begins when its export is written; of a run of the command line, when its settings are.
    written = (folder / RECORD, run / "logo.npy", run / "config.json")
    begun = next((path.stat().st_mtime for path in written if path.is_file()), 0.0)
    record = {"why": why, "begun": begun, "detectors": detectors, "evaluation": read_evaluation(run)}
    return RunState(run, state, progress, **record, **names)


class FoundTrainer:
    """Stands for the process of a trainer that another program started: it runs as long as it holds the run's lock."""

    def __init__(self, run: Path) -> None:
        self._run = run

    def poll(self) -> int | None:
        """Return None while it runs, then the exit code according to the event log."""
        if is_held(self._run / ".lock"):
            return None
        return {DONE: 0, STOPPED: jobs.STOPPED}.get(read_events(self._run / "events.jsonl").outcome, 1)


# --- the panel's list -------------------------------------------------------------------------------------------


def refresh(context: bpy.types.Context) -> bool:
    """Read the disk again; True when something changed. Must not be called while a panel is drawn."""
    named = [run_of(obj) for obj in bpy.data.objects if obj.type == "MESH" and obj.cloak.run]
    if isinstance(session.job, jobs.TrainingJob):
        named.append(session.job.run)
    runs = [run for run in named if run.is_dir() or input_folder(run).is_dir()]  # wherever they lie
    places = [blend_folder()]
    with contextlib.suppress(InputError):  # the output folder cannot be used now: Start says why
        places.append(output_folder(context.scene.cloak))
    for place in filter(None, places):
        runs += find_runs(place)
    states = sorted(map(read_state, dict.fromkeys(runs)), key=lambda state: state.begun, reverse=True)
    fresh = {str(state.path): state for state in states}
    items = context.window_manager.cloak.runs
    if [item.path for item in items] != list(fresh):
        items.clear()
        for path in fresh:
            items.add().path = path
    before, session.runs = session.runs, fresh
    return before != fresh


def selected(context: bpy.types.Context) -> RunState | None:
    """The run that is chosen in the list: the active object's, or the one that was clicked while none was active."""
    return session.runs.get(selected_path(context))


def selected_path(context: bpy.types.Context) -> str:
    """Its folder; "" for none."""
    return session.clicked_run if body_reason(context) else str(run_of(active_body(context)) or "")


def select(context: bpy.types.Context, run: Path | None) -> None:
    """Choose a run, which the active object wears, or will wear, from now on; None for none."""
    session.clicked_run = str(run or "")
    if body_reason(context):
        return
    obj = active_body(context)
    obj.cloak.run = portable(session.clicked_run, blend_folder())
    if run is not None and is_dressed(obj) and obj.mode == "OBJECT" and (run / "colors.npy").is_file():
        with contextlib.suppress(InputError):  # what is chosen is worn; where it does not fit, judging says why
            import_colors(context, obj, run)


def _index(self: "CloakWindow") -> int:
    path = selected_path(bpy.context)
    return next((index for index, item in enumerate(self.runs) if item.path == path), -1)


def _set_index(self: "CloakWindow", index: int) -> None:
    if 0 <= index < len(self.runs):
        select(bpy.context, Path(self.runs[index].path))


class CloakRun(bpy.types.PropertyGroup):
    """A line of the list."""

    path: props.text("Path", "Folder of the run", options={"SKIP_SAVE"})


class CloakWindow(bpy.types.PropertyGroup):
    """What Cloak keeps for this session, out of reach of undo."""

    runs: CollectionProperty(name="Runs", description="The runs that were found", type=CloakRun, options={"SKIP_SAVE"})
    run_index: props.whole(
        "Run", "The run whose colours the active body wears, or will wear", get=_index, set=_set_index
    )


@between_strokes(REFRESH_SECONDS)
def _watch() -> float:
    """The timer's function; it goes on whatever a folder holds."""
    try:
        if time.monotonic() - session.runs_drawn < WATCHED_SECONDS and refresh(bpy.context):
            redraw(panels_alone=True)
    except Exception:
        LOG.exception("The list of runs")
    return REFRESH_SECONDS


@persistent
def _forget_click(*_: object) -> None:
    """After loading a file: forget the clicked run and the finished jobs, and close the eye on the former body."""
    if session.eye is not None:
        session.eye.cancel()
    session.clicked_run = ""
    session.given_runs.clear()
    session.jobs = [job for job in session.jobs if job.active]


CLASSES = (CloakRun, CloakWindow)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    _register_classes()
    bpy.types.WindowManager.cloak = PointerProperty(type=CloakWindow)
    bpy.app.handlers.load_post.append(_forget_click)
    if not bpy.app.background:
        bpy.app.timers.register(_watch, first_interval=REFRESH_SECONDS, persistent=True)


def unregister() -> None:
    if bpy.app.timers.is_registered(_watch):
        bpy.app.timers.unregister(_watch)
    bpy.app.handlers.load_post.remove(_forget_click)
    del bpy.types.WindowManager.cloak
    _unregister_classes()
