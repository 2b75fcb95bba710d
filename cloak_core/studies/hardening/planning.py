"""How many updates fit into some hours, from a few that are tried first."""

from __future__ import annotations

import itertools
import statistics
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

from cloak_core.core.events import read_events
from cloak_core.core.objective import gradient_step
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.studies.hardening.folder import Material
from cloak_core.studies.hardening.hardening import harden
from cloak_core.studies.hardening.pool import FINISH, SLOTS, Pool
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import Student

TRIED = 3
"""Turns, or steps of a cloak, that are timed."""
KEPT_BACK = 0.05
"""Share of the time for checkpoints and writing."""
FOR_FINISHED = 0.2
"""Largest share of the time for the cloaks that are trained to their end first."""
LEAST_STEPS = 50
"""Updates below which nothing is hardened."""


@dataclass(frozen=True)
class Pace:
    """Seconds of an update with all that belongs to it, and of a step of a cloak."""

    update: float
    cloak_step: float


def plan(settings: HardenSettings, pace: Pace, hours: float) -> HardenSettings:
    """Choose the number of updates, and of cloaks finished first, that take `hours` at this pace.

    InputError: fewer than `LEAST_STEPS` updates fit.
    """
    seconds = 3600 * hours * (1 - KEPT_BACK)
    each = FINISH * pace.cloak_step
    finished = min(settings.finished if settings.decoys else 0, int(FOR_FINISHED * seconds / each))
    steps = int((seconds - finished * each) / pace.update)
    if steps < LEAST_STEPS:
        least = LEAST_STEPS * pace.update / (1 - KEPT_BACK) / 3600
        raise InputError(
            f"--hours {hours:g}: {max(steps, 0)} updates of {pace.update:.2g} s fit, which hardens nothing; "
            f"{LEAST_STEPS} take {least:.2g} hours, and the default {HardenSettings.steps} are better"
        )
    return replace(settings, steps=steps, finished=finished)


def measure_pace(settings: HardenSettings, student: Student, material: Material) -> Pace:
    """Try a hardening in a folder of its own, and leave the student as it was. Arguments as for `harden`.

    Views are rendered anew for each cloak at first, so that the updates tried are rather slow ones.
    """
    before = {name: value.clone() for name, value in student.network.state_dict().items()}
    few = replace(settings, steps=SLOTS + 1 + TRIED, finished=0, max_seconds=None)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "tried"
        try:
            tried = harden(few, student, material, out)
        finally:
            student.network.load_state_dict(before)
        if tried.stopped:
            raise KeyboardInterrupt  # nothing was begun yet
        ends = [event["time"] for event in read_events(out / "events.jsonl") if event["type"] == "step"]
    updates = [later - earlier for earlier, later in itertools.pairwise(ends)][-TRIED:]
    student.detector.requires_grad_(False)
    cloak = Pool(few, material.bodies, material.backgrounds, student.detector).cloak(1, 0)
    steps = []
    for k in range(1 + TRIED):
        started = time.perf_counter()
        gradient_step(cloak.objective, cloak.optimizer, cloak.batcher.batch(k))
        steps.append(time.perf_counter() - started)
    return Pace(statistics.median(updates), statistics.median(steps[1:]))


def recorded_plan(settings: HardenSettings, out: Path) -> HardenSettings:
    """Take the counts that a hardening was begun with, to go on with it. InputError: no such folder."""
    recorded = read_json(out / "config.json").get("settings", {})
    counts = {name: recorded.get(name) for name in ("steps", "finished")}
    if not all(isinstance(count, int) for count in counts.values()):
        raise InputError(f"{out / 'config.json'}: does not say its counts (settings.steps, settings.finished)")
    return replace(settings, **counts)


def planned_words(settings: HardenSettings, pace: Pace, hours: float) -> str:
    """Say what a plan does, in one line."""
    finished = settings.finished * FINISH * pace.cloak_step
    return (
        f"--hours {hours:g}: {settings.finished} cloaks trained first ({finished / 60:.0f} min), then {settings.steps} "
        f"updates of {pace.update:.2g} s ({settings.steps * pace.update / 60:.0f} min)"
    )
