"""`cloak bench ...`: figures measured on this machine, written by the command that measured them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cloak_core.commands.base import Command, out


@dataclass(kw_only=True)
class Views(Command):
    """Time visibility, a new view and a cached render, per view."""

    scene: Path
    """Scene folder or .npz."""
    samples: Literal[1, 4, 16, 64] = 1
    """Samples per pixel."""
    threads: int = 2
    """Threads torch may use."""
    repeats: int = 20
    """Timed repetitions behind each median."""

    def run(self) -> dict:
        from cloak_core.bench.views import run_bench_views

        return run_bench_views(self.scene, samples=self.samples, threads=self.threads, repeats=self.repeats)

    def show(self, result: dict) -> None:
        out.print(f"{result['samples']} sample(s) per pixel, {result['threads']} threads; ms per view")
        for key, name in (("visibility_ms", "visibility"), ("new_view_ms", "new view"), ("cached_ms", "cached")):
            out.print(f"{name:<12} median {result[key]['median']:8.3f}   min {result[key]['min']:8.3f}")
