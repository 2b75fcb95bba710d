"""What there is to do, and what came of it. Whoever has a list of work hands it to an `Executor`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from cloak_core.files.errors import InputError


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


@dataclass(frozen=True)
class Outcome:
    """How a job ended."""

    job: Job
    result: object = None
    error: str = ""
    """The message of the InputError that it ended with; "" where it returned."""


@runtime_checkable
class Executor(Protocol):
    """Does jobs."""

    is_here: bool
    """In this very process: work may call back what cannot be sent elsewhere."""

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """The outcomes as they come, in any order. An InputError is an outcome; any other exception of the work is
        raised. Whoever stops listening (closes the iterator) stops what is being done, in order, and the rest."""
        ...


class InOrder:
    """Here, one after the other."""

    is_here = True

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        for job in jobs:
            yield done(job)


def done(job: Job) -> Outcome:
    """Do a job now."""
    try:
        return Outcome(job, result=job.work(**job.arguments))
    except InputError as error:
        return Outcome(job, error=str(error) or "bad input")
