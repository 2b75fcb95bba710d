"""`--ray`: a command whose work falls into parts has them done on a cluster, each part as the command for it alone.

What the parts make lies in files that are found again by their content, so the command itself then only gathers it.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from cloak_core.attack.settings.run import ComputeSettings
from cloak_core.commands.base import err
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    from cloak_core.jobs.job import Outcome
    from cloak_core.jobs.ray_cluster import RayCluster


class Part(Protocol):
    """A command for a part of the work; it can be pickled."""

    def work(self) -> object:
        """Make what is missing. InputError; `Interrupted` where it was ended early, in order."""
        ...


@dataclass(frozen=True, kw_only=True)
class SharingOptions:
    """Where the work is done."""

    ray: str | None = None
    """Share the work over a Ray cluster (extra ray): local for this machine, or an address (auto, HOST:6379,
    ray://HOST:10001) whose machines see the same files. Each run takes --threads cores (default: in order, here)."""
    gpus_per_run: float = 1.0
    """With --ray and --device cuda: GPUs, or share of one, for each run."""

    def executor(self) -> RayCluster | None:
        """InputError: Ray is not installed. None: in order, here."""
        if self.ray is None:
            return None
        from cloak_core.jobs.ray_cluster import RayCluster

        return RayCluster(self.ray)

    def spread(self, parts: Sequence[tuple[str, Part]], compute: ComputeSettings) -> None:
        """Have the parts done, each with its name for people; nothing happens without --ray.

        A part that fails leaves the others alone; then InputError names the first such. Interrupted: a part was ended
        early.
        """
        from cloak_core.evaluation.store import Interrupted
        from cloak_core.jobs.handing_out import hand_out
        from cloak_core.jobs.job import Job

        executor = self.executor()
        if executor is None:
            return
        each = {"cores": compute.threads or 1, "gpus": 0.0 if compute.device == "cpu" else self.gpus_per_run}
        jobs = [Job(name, do, {"part": part}, **each) for name, part in parts]
        failed = []
        with contextlib.closing(hand_out(executor, jobs, err.print, _said, unit="part")) as outcomes:
            for outcome in outcomes:
                if outcome.error:
                    failed.append(f"{outcome.job.name}: {outcome.error}")
                elif outcome.result[1]:
                    raise Interrupted(outcome.result[1])
        if failed:
            raise InputError(f"{len(failed)} of {len(jobs)} parts failed, the first of them {failed[0]}")


def do(part: Part) -> tuple[float, str]:
    """Seconds it took, and why it was ended early, "" where it was not."""
    from cloak_core.evaluation.store import Interrupted

    started, stopped = time.perf_counter(), ""
    try:
        part.work()
    except Interrupted as stop:
        stopped = str(stop) or "interrupted"
    return time.perf_counter() - started, stopped


def _said(outcome: Outcome) -> str:
    return f"failed: {outcome.error}" if outcome.error else f"{outcome.result[0]:.0f} s"
