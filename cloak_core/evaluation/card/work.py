"""How far an assessment is, in images that pass the detector, and how long its parts took, over all calls."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json

OnWork = Callable[[str, float, float], None]
"""Told what is being done, how much of all is done, and how much there is in all."""
TRAINED = 3
"""An image that is trained on costs about so many that are only looked at: forward, and backward twice that."""


class Work:
    """The parts of an assessment with what each costs; told by trainings and evaluations as they go on.

    `seconds` of every part are kept in a file, so that what an earlier, stopped call spent counts too; a part that was
    done already costs nothing more. `asked` names what is assessed: of another, earlier times mean nothing.
    """

    def __init__(
        self,
        costs: dict[str, tuple[float, float]],
        file: Path,
        asked: str,
        on_work: OnWork | None = None,
        seeds: int = 1,
    ) -> None:
        self.costs, self.on_work, self.seeds = costs, on_work, seeds
        """By part: its trainings' (one for each seed) and its evaluations' images."""
        self.total = sum(map(sum, costs.values()))
        self._file, self._record = file, {"asked": asked, "seconds": {}, "done": []}
        earlier = read_json(file) if file.exists() else {}
        if earlier.get("asked") == asked:
            self._record = earlier
        self._name, self._before, self._ended, self._steps = "", 0.0, 0, 1

    @property
    def seconds(self) -> float:
        return round(sum(self._record["seconds"].values(), 0.0), 1)

    @contextlib.contextmanager
    def part(self, name: str) -> Iterator[None]:
        """What is done inside is this part."""
        self._name, self._ended, started = name, 0, time.monotonic()
        self._tell(0.0)
        try:
            yield
            self._finish(name, started, done=True)
        except BaseException:
            self._finish(name, started, done=False)
            raise
        self._before += sum(self.costs[name])
        self._tell(0.0)

    def _finish(self, name: str, started: float, done: bool) -> None:
        seconds, finished = self._record["seconds"], self._record["done"]
        if name not in finished:
            seconds[name] = seconds.get(name, 0.0) + time.monotonic() - started
            finished += [name] * done
            write_json(self._file, self._record)

    def on_event(self, event: dict) -> None:
        """Of a training."""
        if event.get("type") in ("start", "resume"):
            self._steps = event.get("steps") or 1
        elif event.get("type") == "step":
            share = (self._ended + min(1.0, event["step"] / self._steps)) / self.seeds
            self._tell(self.costs[self._name][0] * share)
        elif event.get("type") == "end":
            self._ended += 1

    def on_images(self, done: int, total: int) -> None:
        """Of an evaluation."""
        trained, looked = self.costs[self._name]
        self._tell(trained + looked * done / total)

    def _tell(self, done: float) -> None:
        if self.on_work:
            self.on_work(self._name, self._before + done, self.total)
