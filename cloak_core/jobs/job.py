"""What there is to do, who does it, and what came of it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from cloak_core.files.errors import InputError

Tell = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Job:
    """A call that another process or machine could make as well."""

    name: str
    """For people."""
    work: Callable[..., object]
    """A function of a module. Done twice it does no harm: what is there already is gone on with."""
    arguments: Mapping[str, object] = field(default_factory=dict)
    """By name. They and what the work returns can be pickled."""
    cores: float = 1.0
    gpus: float = 0.0


def resources(threads: int | None, device: str, gpus: float) -> dict[str, float]:
    """Say what a job takes that computes with `threads` threads on a torch device; gpus: the part of a GPU."""
    return {"cores": float(threads or 1), "gpus": 0.0 if device in ("cpu", "auto") else gpus}


@dataclass(frozen=True)
class Outcome:
    """How a job ended."""

    job: Job
    result: object = None
    error: str = ""
    """The message of the InputError that it ended with; "" where it returned."""
    seconds: float = 0.0
    """It took, where it was done."""

    def require(self) -> None:
        """Require that the job returned. InputError: it ended with one."""
        if self.error:
            raise InputError(self.error)


@runtime_checkable
class Executor(Protocol):
    """Does jobs elsewhere."""

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Yield the outcomes as they come, in any order. An InputError is an outcome; other exceptions are raised.

        Closing the iterator stops what is being done, in order, and the rest.
        """
        ...


def in_order(jobs: Sequence[Job]) -> Iterator[Outcome]:
    """Do jobs in this process, one after the other."""
    for job in jobs:
        yield done(job)


def done(job: Job) -> Outcome:
    """Do a job now."""
    started = time.perf_counter()
    result = None
    error = ""
    try:
        result = job.work(**job.arguments)
    except InputError as refused:
        error = str(refused) or "bad input"
    return Outcome(job, result, error, time.perf_counter() - started)


def hand_out(executor: Executor | None, jobs: Sequence[Job], tell: Tell, unit: str) -> Iterator[Outcome]:
    """Yield the outcomes as they come, and tell after each how many `unit`s are done and how long the others will take.

    executor: who does them; None: this process, in order. Closing the iterator stops what is being done elsewhere.
    """
    started = time.perf_counter()
    # Closed at the end whatever happens: what is still trained elsewhere then ends in order.
    with contextlib.closing(executor.run(jobs) if executor else in_order(jobs)) as outcomes:
        for count, outcome in enumerate(outcomes, 1):
            yield outcome
            words = f"failed: {outcome.error}" if outcome.error else f"{outcome.seconds:.0f} s"
            left = (time.perf_counter() - started) * (len(jobs) / count - 1)
            about = f"{left / 60:.0f} min" if left >= 90 else f"{left:.0f} s"
            rest = f", about {about} left" if count < len(jobs) else ""
            tell(f"{unit} {count} of {len(jobs)}: {outcome.job.name}: {words}{rest}")
