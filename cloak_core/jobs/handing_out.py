"""Handing jobs to an executor, with a line of progress for each that ends."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence

from cloak_core.jobs.job import Executor, Job, Outcome

Tell = Callable[[str], None]


def hand_out(
    executor: Executor, jobs: Sequence[Job], tell: Tell, said: Callable[[Outcome], str], unit: str = "job"
) -> Iterator[Outcome]:
    """The outcomes as they come; after each one a line: how many `unit`s are done, what is `said` of this one, and
    about how long the others will take. Whoever closes this stops what is being done elsewhere, in order."""
    started = time.perf_counter()
    # Closed at the end whatever happens: what is still trained elsewhere then ends in order.
    with contextlib.closing(executor.run(jobs)) as outcomes:
        for count, outcome in enumerate(outcomes, 1):
            yield outcome
            minutes = (time.perf_counter() - started) / 60 * (len(jobs) / count - 1)
            rest = f", about {minutes:.0f} min left" if count < len(jobs) else ""
            tell(f"{unit} {count} of {len(jobs)}: {outcome.job.name}: {said(outcome)}{rest}")
