"""`--ray`: share the parts of a command's work over a cluster.

Each part is the same command for that part alone; what it makes lies in files that are found by their content, so that
the command itself then only gathers it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Self

from tyro.conf import OmitArgPrefixes, arg

from cloak_core.commands.base import Command, err
from cloak_core.core.settings.components import ComputeSettings
from cloak_core.files.errors import InputError, Stopped

if TYPE_CHECKING:
    from cloak_core.jobs.ray_cluster import RayCluster


def executor_of(address: str | None) -> RayCluster | None:
    """Make what does the jobs on the cluster at an address; None: there is none. InputError: Ray is not installed."""
    if address is None:
        return None
    from cloak_core.jobs.ray_cluster import RayCluster

    return RayCluster(address)


@dataclass(frozen=True, kw_only=True)
class SharingOptions:
    """Where the work is done."""

    ray: str | None = None
    gpus_per_run: float = 1.0
    """With --ray on CUDA: GPUs for each run, or a share of one."""

    def spread(self, parts: Sequence[tuple[str, Sharing]], compute: ComputeSettings) -> None:
        """Have the parts (commands with `work`) done, each with its name for people; do nothing without --ray.

        A part that fails leaves the others alone; then InputError names the first such. Stopped: a part was ended
        early.
        """
        from cloak_core.jobs.job import Job, hand_out, resources

        executor = executor_of(self.ray)
        if executor is None:
            return
        each = resources(compute.threads, compute.device, self.gpus_per_run)
        jobs = [Job(name, do, {"part": part}, **each) for name, part in parts]
        failed = []
        with contextlib.closing(hand_out(executor, jobs, err.print, "part")) as outcomes:
            for outcome in outcomes:
                if outcome.error:
                    failed.append(f"{outcome.job.name}: {outcome.error}")
                elif outcome.result:
                    raise Stopped(outcome.result)
        if failed:
            raise InputError(f"{len(failed)} of {len(jobs)} parts failed, the first of them {failed[0]}")


@dataclass(kw_only=True)
class Sharing(Command):
    """A command whose work falls into parts."""

    sharing: Annotated[OmitArgPrefixes[SharingOptions], arg(name="many machines")] = field(
        default_factory=SharingOptions
    )

    def work(self) -> object:
        """Make what is missing of a part. InputError; `Stopped` where it was ended early, in order."""
        raise NotImplementedError

    def part_of(self, **changes: object) -> Self:
        """Make the same command for a part of the work, done where it is run."""
        return replace(self, sharing=SharingOptions(), **changes)


def do(part: Sharing) -> str:
    """Do a part; say why it was ended early, "" where it was not."""
    try:
        part.work()
    except Stopped as stop:
        return str(stop) or "interrupted"
    return ""
