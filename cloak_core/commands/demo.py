"""`cloak demo`: the main job from end to end, on what is embedded."""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from cloak_core.commands.base import err, out
from cloak_core.commands.evaluate import Evaluate, Report, show_success
from cloak_core.commands.logo import write_logo
from cloak_core.commands.options import Computing
from cloak_core.commands.train import Train
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.settings import make_settings
from cloak_core.sources.bodies.opening import load_scene

REGION = "chest+thighs"
ANGLES = "-10:10:5"
HARDER = {"loss": "log", "tv_weight": 1.0}
"""Beside preset `best`: the built-in detector's scores saturate, and where they do only "log" still pulls."""


@dataclass(kw_only=True)
class Demo(Computing):
    """Train, evaluate and report a cloak for the sample bodies, against the built-in detector."""

    example = "--out runs/demo"
    then = "zoo list"
    next_why = "what was trained for longer"

    out: Path = Path("runs/demo")
    """Run folder; an interrupted demo goes on there, a complete one is evaluated again."""
    steps: int = 360
    """Updates of the colours."""
    seed: int = 0

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
            changes = HARDER | {"steps": self.steps, "seed": self.seed, "angles": ANGLES} | vars(self.compute)
            settings = make_settings("best", **changes)
            Train.of(settings, scene="sample:train", logo=logo, out=self.out, resume=self.out.exists()).run()
        result = Evaluate(
            run_folder=self.out,
            scene="sample:unseen",
            backgrounds="procedural:test",
            settings=EvaluateSettings(seed=self.seed),
            compute=self.compute,
        ).run()
        return result | Report(run_folder=self.out).run()

    def show(self, result: dict) -> None:
        show_success(result)
        out.print(f"wrote {result['report']}: open it in a browser")
        if shutil.which("cloak") is None:  # make ran the environment's Python; a terminal does not know it yet
            out.print(f"Next: . {Path(sys.executable).parent / 'activate'}, which makes `cloak` a command of yours")
