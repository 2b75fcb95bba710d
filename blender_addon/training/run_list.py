# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel's list of runs: those in the output folder, those beside the .blend file, and those that objects wear.

The list is a view of the disk. It lives on the window manager, which undo leaves alone, and is read again every other
second while the panel is being looked at.
"""

import contextlib
import logging
import time
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.props import CollectionProperty, PointerProperty

from ..blender.blend_paths import blend_folder, portable
from ..body.garments import is_dressed
from ..body.objects import active_body, body_reason
from ..files.errors import InputError
from ..properties import output_folder
from ..session import session
from ..trainer import jobs
from ..ui import props
from ..ui.window import between_strokes, redraw
from .run_states import RunState, find_runs, read_state
from .runs import import_colors, input_folder, run_of

LOG = logging.getLogger(__name__)
REFRESH_SECONDS = 2.0
WATCHED_SECONDS = 5.0  # the list is refreshed for this long after it was last drawn


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
    found = sorted(map(read_state, dict.fromkeys(runs)), key=lambda state: state.begun, reverse=True)
    fresh = {str(state.path): state for state in found}
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
    """After loading a file: forget the clicked run and the finished jobs."""
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
