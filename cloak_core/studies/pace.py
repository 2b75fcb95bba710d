"""How long work takes: of detectors by a few images, of a list of work by what is done of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.studies.report.words import duration

SOON = 10.0
"""Seconds before which nothing is said of the time left."""
Item = TypeVar("Item")


@dataclass(frozen=True)
class Pace:
    """Seconds for an image of a detector: forward alone, and with its gradient (of a black box: forward alone)."""

    forward: float
    gradient: float


def measured_pace(detector: Detector, size: int, gradient_threads: int | None = None) -> Pace:
    """Time a detector on two images, the better of two turns each.

    gradient_threads: of the CPU, for the gradient; None: as many as torch has.
    """
    images = torch.rand(2, 3, size, size, generator=torch.Generator().manual_seed(0)).to(detector.device)
    forward = torch.no_grad()(lambda: max_person_score(detector(images)))

    def gradient() -> None:
        pixels = images.clone().requires_grad_()
        with torch_threads(gradient_threads):
            torch.autograd.grad(max_person_score(detector(pixels)).sum(), pixels)

    alone = _timed(forward)
    return Pace(alone, _timed(gradient) if detector.differentiable else alone)


def _timed(work: Callable[[], object]) -> float:
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        work()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    return min(seconds) / 2


def in_turn(
    items: Sequence[Item],
    name: Callable[[Item], str],
    tell: Callable[[str], None],
    weight: Callable[[Item], float] = lambda item: 1.0,
) -> Iterator[Item]:
    """Yield the items, and say before each which of how many it is, and about how long it and the rest take.

    weight: how long an item takes, in any unit.
    """
    began = time.monotonic()
    done, total = 0.0, sum(map(weight, items))
    for number, item in enumerate(items, 1):
        spent = time.monotonic() - began
        is_known = number > 1 and spent > SOON
        left = f"; about {duration(spent / done * (total - done))} left" if is_known else ""
        tell(f"{number} of {len(items)}: {name(item)}{left}")
        yield item
        done += weight(item)
