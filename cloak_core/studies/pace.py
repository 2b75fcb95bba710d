"""How long work takes: of a detector by a few images, of a list by what is done of it, of a card by its parts."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import torch

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json
from cloak_core.studies.report.words import duration

SOON = 10.0
"""Seconds before which nothing is said of the time left."""
Item = TypeVar("Item")


@dataclass(frozen=True)
class DetectorPace:
    """Seconds for an image of a detector: forward alone, and with its gradient (of a black box: forward alone)."""

    forward: float
    gradient: float


def measured_pace(detector: Detector, size: int, gradient_threads: int | None = None) -> DetectorPace:
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
    return DetectorPace(alone, _timed(gradient) if detector.differentiable else alone)


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


OnWork = Callable[[str, float, float], None]
"""Called with what is being done, how much of all is done, and how much there is in all."""
TRAINED = 3
"""Cost of an image that is trained on, in images that are only looked at: forward, and backward twice that."""


@dataclass
class Work:
    """The parts of an assessment with their costs; trainings and evaluations tell it how far they are.

    The seconds of every part are kept in a file, so that an earlier, stopped call counts too; a part that was done
    already adds none.
    """

    costs: dict[str, tuple[float, float]]
    """By part, the images of its trainings (one for each seed; each counts `TRAINED`) and of its evaluations."""
    file: Path
    asked: str
    """Names what is assessed: earlier times of anything else are dropped."""
    on_work: OnWork | None = None
    seeds: int = 1

    def __post_init__(self) -> None:
        earlier = read_json(self.file) if self.file.exists() else {}
        is_same = earlier.get("asked") == self.asked
        self._record = {"asked": self.asked, "seconds": {}, "done": []} | (earlier if is_same else {})
        self.total = float(sum(map(sum, self.costs.values())))
        self._before, self._steps = 0.0, 1

    @property
    def seconds(self) -> float:
        """Time of all parts, over all calls."""
        return round(float(sum(self._record["seconds"].values())), 1)

    def seconds_left(self, pace: DetectorPace) -> float:
        """Estimate the time of the parts that no call has finished."""
        left = [cost for name, cost in self.costs.items() if name not in self._record["done"]]
        return float(sum(trained / TRAINED * pace.gradient + looked * pace.forward for trained, looked in left))

    @contextlib.contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count what is done inside as this part."""
        seconds, finished = self._record["seconds"], self._record["done"]
        started, is_new = time.monotonic(), name not in finished
        self._name, self._trainings, self._looked, self._last = name, 0, 0, 0
        self._tell(0.0)
        try:
            yield
            finished += [name] * is_new
        finally:
            if is_new:
                seconds[name] = seconds.get(name, 0.0) + time.monotonic() - started
                write_json(self.file, self._record)
        self._before += sum(self.costs[name])
        self._tell(0.0)

    def on_event(self, event: dict) -> None:
        """Take an event of a training."""
        if event.get("type") in ("start", "resume"):
            self._steps = event.get("steps") or 1
        elif event.get("type") == "step":
            share = (self._trainings + min(1.0, event["step"] / self._steps)) / self.seeds
            self._tell(self.costs[self._name][0] * share)
        elif event.get("type") == "end":
            self._trainings += 1

    def on_images(self, done: int, total: int) -> None:
        """Take the images of an evaluation; a part has several, one after the other."""
        trained, looked = self.costs[self._name]
        self._looked += self._last if done <= self._last else 0
        self._last = done
        self._tell(float(trained + min(looked, self._looked + done)))

    def _tell(self, done: float) -> None:
        if self.on_work:
            self.on_work(self._name, self._before + done, self.total)
