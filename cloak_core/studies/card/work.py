"""How far an assessment is, in images that pass the detector, and how long its parts took, over all calls."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json
from cloak_core.studies.card.protocol import ENOUGH

OnWork = Callable[[str, float, float], None]
"""Called with what is being done, how much of all is done, and how much there is in all."""
TRAINED = 3
"""Cost of an image that is trained on, in images that are only looked at: forward, and backward twice that."""
RESERVE = 0.1
"""Share of the time that is kept for pictures and pages."""
LEAST = 0.04
"""Share of its full size that a part has at the least."""


class Work:
    """The parts of an assessment with their costs; trainings and evaluations tell it how far they are.

    The seconds of every part are kept in a file, so that an earlier, stopped call counts too; a part that was done
    already adds none. `asked` names what is assessed: earlier times of anything else are dropped. Where the time is
    limited, each part gets its share of what is left; that is kept, too, so that the same call asks for the same again.
    """

    def __init__(
        self,
        costs: dict[str, tuple[float, float]],
        file: Path,
        asked: str,
        on_work: OnWork | None = None,
        seeds: int = 1,
        minutes: float | None = None,
        rate: float = 0.0,
        optional: Sequence[str] = (),
        prepared: float = 0.0,
    ) -> None:
        """costs: by part, the images of its trainings (one for each seed) and of its evaluations.

        minutes: the time for all; rate: seconds that an image takes, as long as nothing was measured; optional: parts
        that are dropped, the first one first, where an attack would get less than `ENOUGH` of its full size; prepared:
        seconds that this call took so far.
        """
        self.costs, self.on_work, self.seeds, self.optional = costs, on_work, seeds, optional
        self.minutes, self._rate = minutes, rate
        self._file = file
        self._record: dict = {"asked": asked, "seconds": {}, "training": {}, "done": [], "shares": {}}
        earlier = read_json(file) if file.exists() else {}
        if earlier.get("asked") == asked:
            self._record |= earlier
        self._record.setdefault("prepared", 0.0)
        if len(self._record["done"]) < len(costs):
            self._record["prepared"] += prepared
        self._name, self._before, self._ended, self._steps, self._began = "", 0.0, 0, 1, 0.0
        self._share = 1.0

    @property
    def seconds(self) -> float:
        """Time of all parts and of what was loaded for them, over all calls."""
        return round(self._record["prepared"] + sum(self._record["seconds"].values()), 1)

    @property
    def shares(self) -> dict[str, float]:
        """By part, the share of its full size that the time allowed."""
        return self._record["shares"]

    @property
    def total(self) -> float:
        """Cost of all parts; those to come are expected to get the share of the latest one."""
        return sum(sum(self._cost(name)) for name in self.costs)

    def _cost(self, name: str) -> tuple[float, float]:
        share = self.shares.get(name, self._share)
        return self.costs[name][0] * share, self.costs[name][1] * share

    @contextlib.contextmanager
    def part(self, name: str) -> Iterator[float]:
        """Count what is done inside as this part; gives the share of its full size that the time allows, 0: none."""
        if name not in self.shares:
            self._plan(name)
            write_json(self._file, self._record)
        share = self.shares[name]
        self._share = share or self._share
        self._name, self._ended, started, done = name, 0, time.monotonic(), False
        self._tell(0.0)
        try:
            yield share
            done = True
        finally:
            seconds, finished = self._record["seconds"], self._record["done"]
            if name not in finished:
                seconds[name] = seconds.get(name, 0.0) + time.monotonic() - started
                finished += [name] * done
                write_json(self._file, self._record)
        self._before += sum(self._cost(name))
        self._tell(0.0)

    def _plan(self, name: str) -> None:
        """Settle the share of a part; before an attack, drop optional parts until what is left is worth while."""
        share = self._affordable()
        for other in self.optional if self.costs[name][0] else ():
            if share < ENOUGH and other not in self.shares:
                self.shares[other] = 0.0
                share = self._affordable()
        self.shares.setdefault(name, share)

    def _affordable(self) -> float:
        """What is left of the time over what all parts that are left would take, at the paces so far; at most 1.

        Trainings and evaluations have paces of their own: a training sees few views again and again, an evaluation
        many once.
        """
        if self.minutes is None:
            return 1.0
        finished, trained = self._record["done"], self._record["training"]
        spent = [sum(trained.get(name, 0.0) for name in finished)]
        spent += [sum(self._record["seconds"][name] for name in finished) - spent[0]]
        rest = 0.0
        for k, seconds in enumerate(spent):
            done = sum(self.costs[name][k] * self.shares[name] for name in finished)
            pace = seconds / done if done and seconds else self._rate
            left_to_do = [name for name in self.costs if name not in finished and self.shares.get(name) != 0]
            rest += pace * sum(self.costs[name][k] for name in left_to_do)
        left = 60 * self.minutes * (1 - RESERVE) - self.seconds
        return round(min(1.0, max(LEAST, left / rest)), 3) if rest else 1.0

    def on_event(self, event: dict) -> None:
        """Take an event of a training."""
        if event.get("type") in ("start", "resume"):
            self._steps, self._began = event.get("steps") or 1, time.monotonic()
        elif event.get("type") == "step":
            share = (self._ended + min(1.0, event["step"] / self._steps)) / self.seeds
            self._tell(self._cost(self._name)[0] * share)
        elif event.get("type") == "end":
            self._ended += 1
            trained = self._record["training"]
            trained[self._name] = trained.get(self._name, 0.0) + time.monotonic() - self._began

    def on_images(self, done: int, total: int) -> None:
        """Take the progress of an evaluation."""
        trained, looked = self._cost(self._name)
        self._tell(trained + looked * done / total)

    def _tell(self, done: float) -> None:
        if self.on_work:
            self.on_work(self._name, self._before + done, self.total)
