# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel's list of runs: those in the output folder, those beside the .blend file, and those that objects wear.

The list is a view of the disk. It lives on the window manager, which undo leaves alone, and is read again every other
second while the panel is being looked at.
"""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.props import CollectionProperty, IntProperty, PointerProperty, StringProperty

from . import jobs
from .blend_paths import absolute, blend_folder, portable
from .body import active_body
from .files.errors import InputError
from .properties import output_folder, settings_of
from .redrawing import redraw
from .run_states import RunState, find_runs, read_state
from .runs import input_folder

REFRESH_SECONDS = 2.0
WATCHED_SECONDS = 5.0
"""The list is not read any more when it was not drawn for so long."""

states: dict[str, RunState] = {}
"""The runs of the list, by their paths; the latest first."""
_drawn = 0.0
_selected = ""


def places(context: bpy.types.Context) -> list[Path]:
    """Folders in which runs are looked for."""
    found = [blend_folder()]
    with contextlib.suppress(InputError):  # the output folder cannot be used now: Start says why
        found.append(output_folder(settings_of(context)))
    return [place for place in dict.fromkeys(found) if place is not None]


def named_runs() -> list[Path]:
    """Runs that objects of this file wear, and the one of the current job, wherever they lie."""
    found = [Path(absolute(obj.cloak.run)) for obj in bpy.data.objects if obj.type == "MESH" and obj.cloak.run]
    if isinstance(jobs.current, jobs.TrainingJob):
        found.append(jobs.current.run)
    return [run for run in found if run.is_dir() or input_folder(run).is_dir()]


def refresh(context: bpy.types.Context) -> bool:
    """Read the disk again; True when something changed. Must not be called while a panel is drawn."""
    runs = dict.fromkeys([*named_runs(), *(run for place in places(context) for run in find_runs(place))])
    found = sorted(map(read_state, runs), key=lambda state: state.changed, reverse=True)
    fresh = {str(state.path): state for state in found}
    items = context.window_manager.cloak.runs
    if [item.path for item in items] != list(fresh):
        items.clear()
        for path in fresh:
            items.add().path = path
    changed = fresh != states
    states.clear()
    states.update(fresh)
    return changed


def selected(context: bpy.types.Context) -> RunState | None:
    """The run that is chosen in the list: the active object's, or the one that was clicked while none was active."""
    return states.get(selected_path(context))


def selected_path(context: bpy.types.Context) -> str:
    """Its folder; "" for none."""
    obj = _active(context)
    return _selected if obj is None else absolute(obj.cloak.run)


def _active(context: bpy.types.Context) -> bpy.types.Object | None:
    try:
        return active_body(context)
    except InputError:
        return None


def select(context: bpy.types.Context, run: Path | None) -> None:
    """Choose a run, which the active object wears, or will wear, from now on; None for none."""
    global _selected
    _selected = str(run or "")
    obj = _active(context)
    if obj is not None:
        obj.cloak.run = portable(_selected, blend_folder())


def _index(self: CloakWindow) -> int:
    path = selected_path(bpy.context)
    return next((index for index, item in enumerate(self.runs) if item.path == path), -1)


def _set_index(self: CloakWindow, index: int) -> None:
    if 0 <= index < len(self.runs):
        select(bpy.context, Path(self.runs[index].path))


class CloakRun(bpy.types.PropertyGroup):
    """A line of the list."""

    path: StringProperty(name="Path", description="Folder of the run", options={"SKIP_SAVE"})


class CloakWindow(bpy.types.PropertyGroup):
    """What Cloak keeps for this session, out of reach of undo."""

    runs: CollectionProperty(name="Runs", description="The runs that were found", type=CloakRun, options={"SKIP_SAVE"})
    run_index: IntProperty(
        name="Run",
        description="The run whose colours the active body wears, or will wear",
        get=_index,
        set=_set_index,
    )


# --- keeping it fresh -------------------------------------------------------------------------------------------------


def is_drawn() -> None:
    """Somebody looks at the list: it is worth reading."""
    global _drawn
    _drawn = time.monotonic()


def _watch() -> float:
    """The timer's function."""
    if time.monotonic() - _drawn < WATCHED_SECONDS and refresh(bpy.context):
        redraw(panels_alone=True)
    return REFRESH_SECONDS


@persistent
def _forget_click(*_: object) -> None:
    """Another file is open: what was clicked in the last one counts no more."""
    global _selected
    _selected = ""


CLASSES = (CloakRun, CloakWindow)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.WindowManager.cloak = PointerProperty(type=CloakWindow)
    bpy.app.handlers.load_post.append(_forget_click)
    if not bpy.app.background:
        bpy.app.timers.register(_watch, first_interval=REFRESH_SECONDS, persistent=True)


def unregister() -> None:
    if bpy.app.timers.is_registered(_watch):
        bpy.app.timers.unregister(_watch)
    bpy.app.handlers.load_post.remove(_forget_click)
    del bpy.types.WindowManager.cloak
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    states.clear()
