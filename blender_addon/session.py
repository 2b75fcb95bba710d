# SPDX-License-Identifier: GPL-3.0-or-later
"""What this Blender holds beside the open file: jobs, the runs on the disk, what redraws ask again.

One object, `session`, so that whatever can be stale stands in one place. The add-on resets it when it goes. It lies
below every room of the add-on, and knows of what the rooms keep in it only what it asks itself.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

FEW = 30  # objects, about which it is quicker to ask one by one than about the whole scene


@dataclass
class Session:
    """State of one Blender process; nothing of it is saved."""

    jobs: list[Any] = field(default_factory=list)
    """Of `trainer/jobs.py`, as they were asked for: in each lane at most one runs; of each kind the last that ended."""
    allowed: set[str] = field(default_factory=set)
    """Hashes of what the user let run: see `trainer/program.py`."""
    runs: dict[str, Any] = field(default_factory=dict)
    """The runs of the panel's list, by their paths; the latest first."""
    runs_drawn: float = 0.0  # when the list was last drawn, on the monotonic clock
    panel_seen: bool = False  # whether a panel that shows jobs was drawn since it was last asked to
    viewports: dict[int, str] = field(default_factory=dict)
    """What Solid viewports took colours from before they showed ours, by the addresses of their spaces."""
    clicked_run: str = ""  # the run that was chosen while no body was active
    given_runs: dict[int, str] = field(default_factory=dict)
    """The run that an object was last given, by the object's session_uid; undo must not take it away."""
    mesh_changes: int = 0  # grows when any mesh changes shape, and when the frame does
    mesh_changed_at: float = 0.0  # when it last grew, on the monotonic clock
    keeps: bool = False  # whether `kept` may keep: in a window, whose handlers hear of changes before the next redraw
    _kept: dict[object, tuple[set, set]] = field(default_factory=dict)  # what was found; what has changed since

    @property
    def job(self) -> Any:
        """The job that runs, that of the main lane before others; where none does, the one asked for last."""
        running = [job for job in self.jobs if job.running]
        return min(running, key=lambda job: job.lane, default=self.jobs[-1] if self.jobs else None)

    def first_in(self, lane: str) -> Any:
        """The job of a lane that runs, or will next."""
        return next((job for job in self.jobs if job.active and job.lane == lane), None)

    @property
    def eye(self) -> Any:
        """The detector's eye that is open."""
        return self.first_in("Detector's Eye")

    def job_of(self, *labels: str) -> Any:
        """The last job of these kinds."""
        return next((job for job in reversed(self.jobs) if job.label in labels), None)

    def training_of(self, run: Path) -> Any:
        """The job that trains a run, or will."""
        return next((job for job in self.jobs if job.active and getattr(job, "run", None) == run), None)

    def kept(self, find: Callable[[Any, set | None], set], obj: Any) -> set:
        """Return what `find(obj, among)` chooses, for redraws: kept; only about objects that changed it is asked again.

        among: some objects, or None for all of the scene: where many changed, or `obj` itself did.
        """
        value, changed = self._kept.get((find, obj.session_uid), (None, set()))
        if value is None or obj in changed or len(changed) > FEW or not self.keeps:
            value = find(obj, None)
        elif changed:
            value = (value - changed) | find(obj, changed)
        self._kept[find, obj.session_uid] = value, set()
        return value

    def note_change(self, geometry: bool, changed: set | None = None) -> None:
        """Note that these objects changed, None for anything else; with `geometry` the shape of a mesh did."""
        if changed is None:
            self._kept.clear()
        for _, since in self._kept.values():
            since |= changed
        if geometry:
            self.mesh_changes += 1
            self.mesh_changed_at = time.monotonic()

    def reset(self) -> None:
        """Forget everything."""
        self.__init__()


session = Session()
