"""Set the number of updates that fit into some hours, from the time of a few."""

from __future__ import annotations

import itertools
import statistics
import tempfile
from dataclasses import replace
from pathlib import Path

from cloak_core.core.events import OnEvent, read_events
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.studies.hardening.hardening import HardenMaterial, harden
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import Student

TRIED = 3
"""Updates that are timed, after a first."""
KEPT_BACK = 0.05
"""Share of the time for checkpoints and writing."""
LEAST_STEPS = 50
"""Updates below which nothing is hardened."""
HELD = 480, 2800
"""Fewest and most updates with which a detector of docs/hardening.md withstood cloaks."""


def plan(settings: HardenSettings, pace: float, hours: float) -> tuple[HardenSettings, str, str]:
    """Choose the number of updates that take `hours`, at `pace` seconds each.

    Also says, in a line each, what is planned, and warns of a plan that is shorter than any that held ("" where it is
    not). InputError: fewer than `LEAST_STEPS` updates fit.
    """
    steps = int(3600 * hours * (1 - KEPT_BACK) / pace)
    if steps < LEAST_STEPS:
        least = LEAST_STEPS * pace / (1 - KEPT_BACK) / 3600
        raise InputError(
            f"--hours {hours:g}: {steps} updates of {pace:.2g} s fit, which hardens nothing; "
            f"{LEAST_STEPS} take {least:.2g} hours, and the default {HardenSettings.steps} are better"
        )
    least, most = HELD
    planned = f"--hours {hours:g}: {steps} updates of {pace:.2g} s ({steps * pace / 60:.0f} min)"
    needed = least * pace / (1 - KEPT_BACK) / 3600
    few = f"{steps} updates are fewer than any detector withstood cloaks with: {least} take {needed:.2g} hours"
    words = f"{planned}; detectors that withstood cloaks had {least} to {most}"
    return replace(settings, steps=steps), words, few if steps < least else ""


def measure_pace(
    settings: HardenSettings, student: Student, material: HardenMaterial, on_event: OnEvent | None = None
) -> float:
    """Measure the seconds that an update takes with all that belongs to it. Arguments as for `harden`.

    A few updates run in a temporary folder, and the student is set back afterwards: the learning rate of each hangs on
    how many there will be, so that they are no beginning of what is planned.
    """
    before = {name: value.clone() for name, value in student.network.state_dict().items()}
    few = replace(settings, steps=1 + TRIED, max_seconds=None)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "tried"
        try:
            tried = harden(few, student, material, out, on_event=on_event)
        finally:
            student.network.load_state_dict(before)
        if tried.stopped:
            raise KeyboardInterrupt  # nothing was begun yet
        ends = [event["time"] for event in read_events(out / "events.jsonl") if event["type"] == "step"]
    return statistics.median([later - earlier for earlier, later in itertools.pairwise(ends)])


def recorded_plan(settings: HardenSettings, out: Path) -> HardenSettings:
    """Take the number of updates that a hardening was begun with, to go on with it. InputError: no such folder."""
    steps = read_json(out / "config.json").get("settings", {}).get("steps")
    if not isinstance(steps, int):
        raise InputError(f"{out / 'config.json'}: does not say its number of updates (settings.steps)")
    return replace(settings, steps=steps)
