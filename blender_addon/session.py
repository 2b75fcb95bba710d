# SPDX-License-Identifier: GPL-3.0-or-later
"""What this Blender holds beside the open file: jobs, the detector's eye, and the runs found on the disk.

One object, `session`, so that whatever can be stale stands in one place. The add-on resets it when it goes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .result.eye import Eye
    from .trainer.jobs import Job
    from .training.run_states import RunState


@dataclass
class Session:
    """State of one Blender process; nothing of it is saved."""

    jobs: list[Job] = field(default_factory=list)
    """In the order in which they were asked for: at most one runs, some wait, and of each kind the last that ended."""
    eye: Eye | None = None  # the detector's eye that is open
    eye_closed_because: str = ""  # error that closed the last eye; "" if there was none
    runs: dict[str, RunState] = field(default_factory=dict)
    """The runs of the panel's list, by their paths; the latest first."""
    runs_drawn: float = 0.0  # when the list was last drawn, on the monotonic clock
    clicked_run: str = ""  # the run that was chosen while no body was active
    given_runs: dict[int, str] = field(default_factory=dict)
    """The run that an object was last given, by the object's session_uid; undo must not take it away."""
    mesh_changes: int = 0  # grows when any mesh changes shape, and when the frame does
    mesh_changed_at: float = 0.0  # when it last grew, on the monotonic clock

    @property
    def job(self) -> Job | None:
        """The job that runs, else the one that was asked for last."""
        return next((job for job in self.jobs if job.running), self.jobs[-1] if self.jobs else None)

    def job_of(self, *labels: str) -> Job | None:
        """The last job of these kinds."""
        return next((job for job in reversed(self.jobs) if job.label in labels), None)

    def training_of(self, run: Path) -> Job | None:
        """The job that trains a run, or will."""
        return next((job for job in self.jobs if job.active and getattr(job, "run", None) == run), None)

    def reset(self) -> None:
        """Forget everything."""
        self.__init__()


session = Session()
