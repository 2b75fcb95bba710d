"""Train once: a training is kept in OUT/runs/KEY and is found again by its content.

The key is a hash of everything that decides the colours, so that sweeps, matrices, cards and experiments share
trainings, and an interrupted set goes on where it stopped.
"""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from cloak_core.core.events import OnEvent
from cloak_core.core.pattern import Pattern
from cloak_core.core.run_config import FILES, decisive
from cloak_core.core.settings import TrainSettings, settings_record
from cloak_core.core.training import RunResult
from cloak_core.files.errors import InputError, Stopped
from cloak_core.files.identity import package_versions, sha256_arrays, sha256_record
from cloak_core.files.reading import read_json
from cloak_core.files.writing import lock, remove_leftovers, write_json, written
from cloak_core.studies.opening import run_pattern
from cloak_core.studies.trained_run import read_history
from cloak_core.studies.trainings.run_record import Training, device_kind
from cloak_core.studies.trainings.training import train, training_config

_log = logging.getLogger("cloak")
TRAINING_VERSION = 5
"""Raise it by one when the same settings and inputs train other colours than before: after a change of sampling,
objective, optimizer, rendering, detectors or scenes. A change of words, speed or structure keeps every run."""
COST = "cost.json"
"""In a run's folder: its processor time."""
PACKAGES = ("torch", "numpy", "numba", "pillow")


@dataclass(frozen=True, eq=False)
class Trained:
    """The colours of one training."""

    pattern: Pattern
    """In its colours."""
    folder: Path
    seconds: float
    """Wall-clock time of the training."""
    cpu_seconds: float
    """Processor time of the training, all threads; nan where it was not measured."""
    settings: TrainSettings = field(repr=False)


class TrainingStore:
    """A folder of trainings, each in a run folder of its own."""

    def __init__(self, out: Path, on_progress: Callable[[str], None] | None = None, alone: bool = False) -> None:
        """Keep trainings below `out`. on_progress takes lines of progress.

        alone: under torchrun, train in this process and not in all of them together.
        """
        self.out = out
        self.tell = on_progress or partial(_log.info, "%s")
        self.alone = alone
        self.on_event: OnEvent | None = None
        """Takes what trainings log."""
        self._hashes: dict[tuple, str] = {}

    def folder(self, training: Training, label: str = "") -> Path:
        """Name the folder of a training by all that decides its colours, behind a label for people.

        InputError: a file that it names cannot be read.
        """
        settings = decisive({"settings": settings_record(training.settings)}, ("settings",))
        record = settings | {"inputs": self._inputs_hash(training), "training": TRAINING_VERSION}
        key = content_key(record, training.settings.compute.device)
        return self.out / "runs" / (f"{label}-{key}" if label else key)

    def is_done(self, folder: Path) -> bool:
        """Tell whether a run ended by itself."""
        return (folder / "colors.npy").exists() and read_history(folder).outcome == "done"

    def train_once(self, training: Training, folder: Path, words: str) -> Trained:
        """Train into its folder, or find what was trained. words: about the training, for people.

        Stopped: it was stopped in order; the next call goes on.
        """
        with self.locked(folder):
            if not self.is_done(folder):
                self.tell(f"training {words}")
                result = self._go_on(training, folder)
                if result.stopped:
                    raise Stopped(f"{folder}: stopped at step {result.step}: {result.stopped}")
        pattern = run_pattern(folder, training.logo, training.bodies)
        return Trained(pattern, folder, read_history(folder).seconds, _cpu_seconds(folder), training.settings)

    def go_on(self, training: Training, folder: Path) -> RunResult:
        """Train into its folder, from where it is, and tell how that ended; of a complete run, how it had ended."""
        with self.locked(folder):
            return self._go_on(training, folder)

    def _go_on(self, training: Training, folder: Path) -> RunResult:
        clock = folder / COST
        is_clocked = not folder.exists() or clock.exists()  # what was begun without a clock gets none
        earlier, began = _cpu_seconds(folder), time.process_time()
        try:
            return train(**vars(training), out=folder, resume=True, on_event=self.on_event, alone=self.alone)
        finally:
            if is_clocked and folder.exists():
                spent = time.process_time() - began + (0.0 if math.isnan(earlier) else earlier)
                write_json(clock, {"cpu_seconds": round(spent, 2)})

    @contextlib.contextmanager
    def locked(self, folder: Path) -> Iterator[None]:
        """Wait until no other process makes this result, and keep others from it."""
        locks = self.out / "locks"
        with written(locks):
            locks.mkdir(parents=True, exist_ok=True)
        with lock(locks / folder.name, wait=True):
            remove_leftovers(folder)
            yield

    def _inputs_hash(self, training: Training) -> str:
        """Hash what a training is made of beside its settings; once, for many trainings that differ in settings."""
        settings, logo = training.settings, training.logo
        recorded = settings_record(settings)
        named = [recorded[name] for name in FILES]
        precisions = tuple((detector, detector.precision) for detector in training.detectors)
        material = (training.bodies, sha256_arrays(logo.face_ids), precisions, training.backgrounds)
        place = (*material, training.people, *named, settings.pattern)
        if place not in self._hashes:
            config = training_config(training)
            record = decisive(config) | {"settings": None}
            record["packages"] = [detector["packages"] for detector in config["detectors"]]
            self._hashes[place] = sha256_record(record)
        return self._hashes[place]


def _cpu_seconds(folder: Path) -> float:
    """Read the processor time of a run, all threads; nan where it was not measured."""
    path = folder / COST
    return float(read_json(path)["cpu_seconds"]) if path.exists() else math.nan


def content_key(record: Mapping[str, object], device: str) -> str:
    """Name what a record decides, together with the packages and the kind of device that compute it."""
    around = {"packages": package_versions(*PACKAGES), "device": device_kind(device)}
    try:
        return sha256_record(dict(record) | around)[:16]
    except ValueError as error:
        raise InputError(f"settings: {error}") from None


def training_times(trained: Sequence[Trained]) -> dict[str, float | None]:
    """Average `seconds` and `cpu_seconds` over repetitions, one decimal; None where they were not measured."""
    times = {}
    for name in ("seconds", "cpu_seconds"):
        mean = float(np.mean([getattr(run, name) for run in trained]))
        times[name] = None if math.isnan(mean) else round(mean, 1)
    return times
