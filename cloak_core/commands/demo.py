"""`cloak demo`: the main job from end to end, on what is embedded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cloak_core.attack.settings import make_settings
from cloak_core.commands.base import Command, err, open_scene, out
from cloak_core.commands.evaluate import Evaluate, Report, show_success
from cloak_core.commands.logo import write_logo
from cloak_core.commands.train import Train

REGION = "chest+thighs"
HARDER = {"loss": "log", "tv_weight": 1.0}
"""Beside preset `best`: the built-in detector's scores saturate, and where they do only "log" still pulls."""


@dataclass(kw_only=True)
class Demo(Command):
    """Train a chest-and-thighs cloak on the sample bodies against the built-in detector, evaluate, report."""

    out: Path = Path("runs/demo")
    """Run folder; a demo that was interrupted there goes on, one that is complete is evaluated again."""
    steps: int = 600
    """Updates of the colours."""
    seed: int = 0
    """Of every random draw."""

    def run(self) -> dict:
        from cloak_core.scene.logo import select_region

        logo = self.out.parent / f"{self.out.name}-logo.npy"
        bodies = open_scene("sample:train")
        self.out.parent.mkdir(parents=True, exist_ok=True)
        chosen = write_logo(logo, bodies, select_region(bodies, REGION))
        err.print(
            f"{bodies.pose_count} sample bodies, {REGION}: {chosen['faces']} faces, "
            f"{chosen['area_share']:.0%} of the body's area",
            markup=False,
        )
        if not (self.out / "report.html").exists():
            settings = make_settings("best", steps=self.steps, seed=self.seed, angles="-10:10:5", **HARDER)
            Train(scene="sample:train", logo=logo, out=self.out, settings=settings, resume=self.out.exists()).run()
        result = Evaluate(run_folder=self.out).run()
        return result | Report(run_folder=self.out).run()

    def show(self, result: dict) -> None:
        show_success(result)
        out.print(f"wrote {result['report']}", markup=False)
