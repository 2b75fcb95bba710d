"""`cloak sweep`: a training for every combination of a grid of settings."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional, UseAppendAction

from cloak_core.commands.base import err, out
from cloak_core.commands.options import prepare_process
from cloak_core.commands.progress import TrainingProgress
from cloak_core.commands.sharing import Sharing, executor_of
from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_TEXT_BYTES, read_text


@dataclass(kw_only=True)
class Sweep(Sharing):
    """Train every combination of a grid of settings; what is done is skipped.

    The grid is a TOML file: [base] for all runs, and [grid], a list for each name that varies (options of `cloak
    train`). Figures are of training: evaluate what looks good.
    """

    example = "grid.toml --out sweep"
    next_why = "its run with the highest success in training, on what that never saw"

    grid: Positional[Path]
    """TOML file with [base] and [grid]."""
    out: Path
    """Folder for all results; what is there is not done again."""

    detector: UseAppendAction[tuple[str, ...]] = ()
    """Detectors of the grid that run code (python:) or ask the network: only those named here are used."""
    device: str | None = None
    """(default: the grid's, else cpu)"""
    threads: int | None = None
    """(default: the grid's)"""
    seed: int | None = None
    """(default: the grid's, else 0)"""

    def run(self) -> dict:
        from cloak_core.studies.sweeps import Sweep, read_grid

        if int(os.environ.get("WORLD_SIZE", "1")) > 1:
            raise InputError("sweep: torchrun shares out one run; many runs are shared out by --ray")
        executor = executor_of(self.sharing.ray)
        options = {"device": self.device, "threads": self.threads, "seed": self.seed}
        changes = {name: value for name, value in options.items() if value is not None}
        sweep = Sweep(read_grid(self.grid, changes, self.detector), self.out)
        with TrainingProgress() as progress:
            stopped = sweep.run(err.print, progress, prepare_process, executor, self.sharing.gpus_per_run)
        result = {"out": str(self.out)} | sweep.write_results()
        failed = [f"{r['name']}: {r['error']}" for r in result["results"] if "error" in r]
        if failed:
            result["refused"] = f"{len(failed)} of {result['runs']} runs failed, the first of them {failed[0]}"
        return result | ({"stopped": stopped} if stopped else {})

    def show(self, result: dict) -> None:
        out.print(read_text(self.out / "sweep.md", MAX_TEXT_BYTES))
        out.print(f"wrote {self.out / 'sweep.md'}: {result['done']} of {result['runs']} runs done")

    def following(self, result: dict) -> tuple[str, ...]:
        return ("evaluate", str(self.out)) if any("success" in row for row in result["results"]) else ()
