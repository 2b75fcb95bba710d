"""Training through Blender without a window: the add-on's own way, from a body in Blender to the colours on it."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from cloak_core.attack.events import read_events
from cloak_core.commands.base import Stopped
from cloak_core.commands.progress import TrainingProgress
from cloak_core.files.errors import InputError
from cloak_core.scene.blender.outside import ADD_ON

SCRIPT = ADD_ON / "train.py"
LOOK_SECONDS = 0.3


def train_in_blender(python: str, arguments: Sequence[str], run: Path) -> None:
    """Run `blender_addon/train.py` with these arguments, this Python as its trainer, and `run` as its run folder.

    Shows the training's progress. InputError and Stopped carry what it said with exit codes 2 and 3.
    """
    command = [python, str(SCRIPT), "--", *arguments, "--out", str(run), "--python", sys.executable]
    with tempfile.TemporaryFile("w+") as said, TrainingProgress() as progress:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said)
        try:
            follow(run / "events.jsonl", lambda: process.poll() is None, progress)
        except KeyboardInterrupt:
            process.wait()  # it was interrupted as well, and ends its trainer in order
        code = process.wait()
        said.seek(0)
        lines = [line.strip() for line in said if line.strip()]
    last = lines[-1].removeprefix("cloak: ") if lines else ""
    if code == 2:
        raise InputError(last)
    if code == 3:
        raise Stopped(last)
    if code:
        raise RuntimeError(f"training through Blender ended with exit code {code}:\n" + "\n".join(lines[-20:]))


def follow(events: Path, running: Callable[[], bool], tell: Callable[[dict], None]) -> None:
    """Tell the steps of a growing log, each once, until `running` says no; those that were there before are skipped."""
    told, alive = _last_step(events), True
    while alive:
        alive = running()
        for event in read_events(events) if events.exists() else ():
            step = event.get("step")
            if event.get("type") in ("start", "resume"):
                tell(event | {"type": "start"})
            elif event.get("type") == "step" and isinstance(step, int) and step > told:
                tell(event)
                told = step
        time.sleep(LOOK_SECONDS if alive else 0)


def _last_step(events: Path) -> int:
    steps = [event.get("step") for event in (read_events(events) if events.exists() else ())]
    return max((step for step in steps if isinstance(step, int)), default=0)
