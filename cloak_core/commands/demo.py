"""`cloak demo`: the main job from end to end, on what is embedded.

Where there is a Blender it trains the add-on's own way, without a window: from a body in Blender to the colours on it.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cloak_core.commands.base import Stopped, err, load_scene, out, warn
from cloak_core.commands.evaluate import Evaluate, Report, show_success
from cloak_core.commands.logo import write_logo
from cloak_core.commands.options import Computing
from cloak_core.commands.progress import TrainingProgress
from cloak_core.commands.train import Train
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.events import read_events
from cloak_core.core.settings import make_settings
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_text
from cloak_core.sources.bodies.blender.outside import ADD_ON, find_bpy

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
    """Report each beginning and new step of a growing event log once, while `running()`; earlier steps are skipped."""
    told, begun, alive = _last_step(events), 0, True
    while alive:
        alive = running()
        beginnings = 0
        for event in read_events(events) if events.exists() else ():
            step = event.get("step")
            if event.get("type") in ("start", "resume"):
                beginnings += 1
                if beginnings > begun:
                    tell(event | {"type": "start"})
                    begun = beginnings
            elif event.get("type") == "step" and isinstance(step, int) and step > told:
                tell(event)
                told = step
        time.sleep(LOOK_SECONDS if alive else 0)


def _last_step(events: Path) -> int:
    steps = [event.get("step") for event in (read_events(events) if events.exists() else ())]
    return max((step for step in steps if isinstance(step, int)), default=0)


REGION = "chest+thighs"
ANGLES = "-10:10:5"
HARDER = {"loss": "log", "tv_weight": 1.0}
"""Beside preset `best`: the built-in detector's scores saturate, and where they do only "log" still pulls."""


@dataclass(kw_only=True)
class Demo(Computing):
    """Train, evaluate and report a cloak for the sample bodies in one go.

    A chest-and-thighs logo against the built-in detector.
    """

    example = "--out runs/demo"
    next_why = "what was trained for longer; docs/tutorial.md begins at the beginning"

    out: Path = Path("runs/demo")
    """Run folder; a demo that was interrupted there goes on, one that is complete is evaluated again."""
    steps: int = 360
    """Updates of the colours."""
    seed: int = 0
    """Every random draw derives from it."""

    def run(self) -> dict:
        from cloak_core.core.logo import select_region

        self.prepare()
        logo = self.out.parent / f"{self.out.name}-logo.npy"
        bodies = load_scene("sample:train")
        self.out.parent.mkdir(parents=True, exist_ok=True)
        chosen = write_logo(logo, bodies, select_region(bodies, REGION))
        err.print(
            f"{bodies.pose_count} sample bodies, {REGION}: {chosen['faces']} faces, "
            f"{chosen['area_share']:.0%} of the body's area"
        )
        if not (self.out / "report.html").exists():
            self._train(logo, bodies.pose_count)
        result = Evaluate(
            run_folder=self.out,
            scene="sample:unseen",
            backgrounds="procedural:test",
            settings=EvaluateSettings(seed=self.seed),
            compute=self.compute,
        ).run()
        return result | Report(run_folder=self.out).run()

    def _train(self, logo: Path, poses: int) -> None:
        """Train through Blender where there is one, which also pictures the result; else directly, and say so."""
        blender = find_bpy() if SCRIPT.exists() else None
        if blender is None:
            way = "CLOAK_BLENDER names a Python with bpy, tools/setup_blender.sh brings one"
            missing = (
                f"no Blender here ({way})" if SCRIPT.exists() else "the add-on is no part of the installed package"
            )
            warn(f"{missing}: training without Blender, and no picture from it")
        started_directly = self.out.exists() and not self.out.with_name(f"{self.out.name}.input").exists()
        if blender is None or started_directly:
            changes = HARDER | {"steps": self.steps, "seed": self.seed, "angles": ANGLES} | vars(self.compute)
            settings = make_settings("best", **changes)
            Train.of(settings, scene="sample:train", logo=logo, out=self.out, resume=self.out.exists()).run()
            return
        config = self.out.parent.absolute() / f"{self.out.name}-settings.toml"
        further = HARDER | {"seed": self.seed}
        further |= {} if self.compute.threads is None else {"threads": self.compute.threads}
        write_text(config, "".join(f"{key} = {json.dumps(value)}\n" for key, value in further.items()))
        words = f"--sample --frames 1:{poses}:1 --preset best --angles {ANGLES} --steps {self.steps}".split()
        words += ["--resume"] * self.out.is_dir()
        words += ["--logo", str(logo.absolute()), "--device", self.compute.device, "--config", str(config)]
        train_in_blender(blender, words, self.out)

    def show(self, result: dict) -> None:
        show_success(result)
        out.print(f"wrote {result['report']}: open it in a browser")
        if shutil.which("cloak") is None:  # make ran the environment's Python; a terminal does not know it yet
            out.print(f"Next: . {Path(sys.executable).parent / 'activate'}, which makes `cloak` a command of yours")

    def following(self, result: dict) -> tuple[str, ...]:
        return ("zoo", "list")
