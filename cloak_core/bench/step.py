"""`cloak bench step`: a training step against its floor, the detector's forward and input-backward on a ready batch."""

from __future__ import annotations

import dataclasses
import logging
import statistics
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import torch

from cloak_core.bench.measuring import check_counts, machine, timed_in_turn, write_rows
from cloak_core.bench.views import chest_and_thighs
from cloak_core.core.batches import Batcher, Prefetcher
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.events import EventLog
from cloak_core.core.logo import make_logo, shirt_trousers
from cloak_core.core.losses import person_loss
from cloak_core.core.objective import Objective, gradient_step
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.sampling import Sampler
from cloak_core.core.settings import TrainSettings, make_settings
from cloak_core.core.source import NOBODY, Cast
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.exchange.bodies import Bodies
from cloak_core.jobs.job import Tell
from cloak_core.patterns.choosing import pattern_of
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.source import BodyPlan
from cloak_core.studies.pace import in_turn
from cloak_core.studies.trainings.run_record import Training
from cloak_core.studies.trainings.training import make_source
from cloak_core.techniques import build_techniques

_log = logging.getLogger(__name__)


def run_bench_step(
    bodies: Bodies,
    detectors: Sequence[Detector],
    backgrounds: Backgrounds,
    *,
    logo_faces: np.ndarray | None = None,
    settings: TrainSettings | None = None,
    people: Cast = NOBODY,
    threads: int = 2,
    repeats: int = 20,
    tell: Tell = _log.info,
) -> dict:
    """C6's record: {SPEC: {"batch", "floor_ms", "step_ms", "ratio", "overhead_ms_per_image", "parts_ms", ...}}.

    Floor and step take turns, so that whatever else the machine does hits both; medians of `repeats`. The floor sees
    images of the step's own, in the step's memory layout. A step is the whole of it: batch, loss, gradient, update,
    event; where a thread builds the next batch meanwhile (see `looks_ahead`), it ends when that is there, too, which
    would otherwise be charged to the floor. Parts are timed alone: "next_batch" is building a batch, "paint" the logo's
    way into the images and its gradient's way back, "update" the optimiser with total variation and the event; "rest"
    is what they leave of step - floor: negative where a batch is built beside the detector, positive where both fight
    for cores and caches. `settings` (default: preset best, batch 8) decide batch, size, device and views; with a range
    of distances, and with `people` in photographs (default: preset photographs, which trains a cloth), every image pays
    for a view of its own. Logo: chest and thighs unless given; with people shirt and trousers. `tell` hears of each
    detector before it is timed.
    """
    check_counts(repeats, threads)
    settings = settings or make_settings(people.preset())
    with torch_threads(threads):
        tell("building views that the clock does not count")
        bench = Bench(bodies, logo_faces, backgrounds, settings, people)
        turns = in_turn(detectors, lambda detector: f"{detector.name}, {repeats} steps", tell)
        return {detector.spec: bench.measure([detector], repeats) for detector in turns} | {
            "threads": threads,
            "machine": machine(settings.compute.device),
        }


def write_table(result: dict, path: Path) -> None:
    """Write a record of `run_bench_step` as CSV, a row for each detector with machine and threads."""
    rows = [figures for figures in result.values() if isinstance(figures, dict) and "floor_ms" in figures]
    write_rows(path, rows, result["machine"] | {"threads": str(result["threads"])})


class Bench:
    """A training whose steps are timed beside their floor."""

    def __init__(
        self,
        bodies: Bodies,
        logo_faces: np.ndarray | None,
        backgrounds: Backgrounds,
        settings: TrainSettings,
        people: Cast = NOBODY,
    ) -> None:
        """Make its views; arguments as `run_bench_step` has them."""
        self.settings = settings = settings.changed(epochs=None, steps=1_000_000)
        self.device = torch.device(settings.compute.device)
        if logo_faces is None:
            logo_faces = shirt_trousers(bodies) if people else chest_and_thighs(bodies)
        self.logo = make_logo(bodies, logo_faces)
        self.pattern = pattern_of(settings.pattern, bodies, self.logo)
        source = make_source(Training(settings, bodies, self.logo, (), backgrounds, people))
        self.is_fresh = source.is_fresh
        sampler = Sampler(settings, source, len(backgrounds))
        self.batcher = Batcher(settings, sampler, backgrounds, self.pattern, self.device)
        plan = BodyPlan(settings.views, bodies.pose_count, bodies.outfit_count)
        views = plan.members * plan.directions * plan.outfit_count
        # Every view that is kept is to be met before the clock runs: drawn at random, all of n are met after about
        # n (ln n + 3) draws.
        images = 0 if self.is_fresh else views * (np.log(views) + 3)
        for number in range(int(np.ceil(images / settings.run.batch)) + 1):
            self.batcher.batch(number)

    def measure(self, detectors: Sequence[Detector], repeats: int) -> dict:
        """Time steps against these detectors together, and their floor: each alone on the ready batch."""
        settings = self.settings
        techniques, coloring = build_techniques(settings, self.pattern, detectors, self.device)
        objective = Objective(settings, self.pattern, detectors, self.device, techniques)
        grey = torch.full((self.pattern.count, 3), 0.5, device=self.device)
        optimizer = ColorOptimizer(settings.optimization, grey, coloring)
        ready = self.batcher.batch(0).images(optimizer.colors()).detach().clone().requires_grad_()
        upstream = torch.zeros_like(ready)
        prefetcher = Prefetcher(self.batcher)

        def floor(number: int) -> None:
            ready.grad = None
            for detector in detectors:
                person_loss(detector(ready), settings.objective.loss).mean().backward()

        def step(number: int) -> None:
            figures = gradient_step(objective, optimizer, prefetcher.batch(number)).figures
            optimizer.update(settings.optimization.lr)
            log.write({"type": "step", "step": number, "time": 0.0} | dataclasses.asdict(figures))
            prefetcher.finish()

        def next_batch(number: int) -> None:
            batches[0] = self.batcher.batch(500_000 + number)

        def paint(number: int) -> None:
            optimizer.clear()
            batches.pop(0).images(optimizer.colors()).backward(upstream)

        def update(number: int) -> None:
            optimizer.clear()
            objective.total_variation(optimizer.colors()).backward()
            optimizer.update(settings.optimization.lr)
            log.write({"type": "step", "step": 0, "time": 0.0})

        works = {"floor": floor, "step": step, "next_batch": next_batch, "paint": paint, "update": update}
        batches = {}
        with tempfile.TemporaryDirectory() as folder, closing(EventLog(Path(folder, "events.jsonl"))) as log:
            times = timed_in_turn(works, repeats, settings.compute.device)
        prefetcher.close()
        name = " + ".join(dict.fromkeys(detector.name for detector in detectors))
        return {"name": name, **self._record({key: statistics.median(values) for key, values in times.items()})}

    def _record(self, parts: dict[str, float]) -> dict:
        """Compare a step with its floor; parts: medians of all that was timed, milliseconds."""
        floor_ms, step_ms = parts.pop("floor"), parts.pop("step")
        parts["rest"] = step_ms - floor_ms - sum(parts.values())
        return {
            "batch": self.settings.run.batch,
            "floor_ms": round(floor_ms, 3),
            "step_ms": round(step_ms, 3),
            "ratio": round(step_ms / floor_ms, 4),
            "overhead_ms_per_image": round((step_ms - floor_ms) / self.settings.run.batch, 3),
            "parts_ms": {name: round(value, 3) for name, value in parts.items()},
            "views": "fresh" if self.is_fresh else "kept",
            "logo_faces": len(self.logo),
            "colors": self.pattern.count,
        }
