"""`cloak bench step`: a training step against its floor, the detector's forward and input-backward on a ready batch."""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np
import torch

from cloak_core.attack.batches import Batcher
from cloak_core.attack.losses import disappearance
from cloak_core.attack.objective import Objective, gradient_step
from cloak_core.attack.optimizing import ColorOptimizer
from cloak_core.attack.sampling import Sampler, is_fresh
from cloak_core.attack.settings import TrainSettings, make_settings
from cloak_core.bench.views import chest_and_thighs, machine, torch_threads
from cloak_core.detectors.protocol import Detector
from cloak_core.errors import InputError
from cloak_core.render.views import ViewBank
from cloak_core.scene.backgrounds import Backgrounds
from cloak_core.scene.exchange import Bodies
from cloak_core.scene.logo import make_logo


def run_bench_step(
    bodies: Bodies,
    detectors: Sequence[Detector],
    backgrounds: Backgrounds,
    *,
    logo_faces: np.ndarray | None = None,
    settings: TrainSettings | None = None,
    threads: int = 2,
    repeats: int = 20,
) -> dict:
    """C6's record: {SPEC: {"batch", "floor_ms", "step_ms", "ratio", "overhead_ms_per_image", "parts_ms", ...}}.

    Floor and step take turns, so that whatever else the machine does hits both; medians of `repeats`, after a first
    round that builds the views and warms up. `settings` (default: preset best, batch 8) decide batch, size, device and
    views; with a range of distances every image pays for a view of its own. Logo: chest and thighs unless given.
    """
    if repeats < 1 or threads < 1:
        raise InputError(f"repeats {repeats}, threads {threads}: at least 1 each")
    settings = settings or make_settings("best")
    settings = dataclasses.replace(settings, epochs=None, steps=10_000)
    with torch_threads(threads):
        bench = _Bench(bodies, logo_faces, backgrounds, settings)
        return {detector.spec: bench.measure(detector, repeats) for detector in detectors} | {
            "threads": threads,
            "machine": machine(settings.device),
        }


class _Bench:
    def __init__(
        self, bodies: Bodies, logo_faces: np.ndarray | None, backgrounds: Backgrounds, settings: TrainSettings
    ) -> None:
        self.settings = settings
        self.device = torch.device(settings.device)
        faces = chest_and_thighs(bodies) if logo_faces is None else logo_faces
        self.logo = make_logo(bodies, faces)
        sampler = Sampler(settings, bodies.pose_count, bodies.outfit_count, len(backgrounds))
        bank = ViewBank(bodies, device=self.device, **({"samples": settings.samples} if settings.samples else {}))
        self.batcher = Batcher(settings, sampler, bank, self.logo.face_ids, backgrounds, self.device)
        self.optimizer = ColorOptimizer(settings, torch.full((len(self.logo), 3), 0.5, device=self.device))

    def measure(self, detector: Detector, repeats: int) -> dict:
        settings = self.settings
        size = (settings.batch, 3, settings.size, settings.size)
        ready = torch.rand(size, device=self.device, requires_grad=True)
        objective = Objective(settings, self.logo, [detector], self.device)
        parts: dict[str, list[float]] = {"batch": [], "floor": [], "step": []}

        def floor() -> None:
            ready.grad = None
            disappearance(detector(ready), settings.loss, settings.reduce).backward()

        def step(number: int) -> None:
            batch = self.batcher.batch(number)
            gradient_step(objective, self.optimizer, batch)
            self.optimizer.update(settings.lr)

        # Cached views: one round meets every pose, angle and outfit, so that none is built while the clock runs.
        for number in range(self._warm_up_steps()):
            self.batcher.batch(number)
        for number in range(repeats + 2):
            # Two rounds more, for what allocates and compiles on first use.
            for name, action in (
                ("floor", floor),
                ("step", lambda n=number: step(n)),
                ("batch", lambda n=number: self.batcher.batch(5000 + n)),
            ):
                parts[name].append(self._milliseconds(action))
        median = {name: statistics.median(values[2:]) for name, values in parts.items()}
        over = (median["step"] - median["floor"]) / settings.batch
        return {
            "batch": settings.batch,
            "floor_ms": round(median["floor"], 3),
            "step_ms": round(median["step"], 3),
            "ratio": round(median["step"] / median["floor"], 4),
            "overhead_ms_per_image": round(over, 3),
            "parts_ms": {
                "batch": round(median["batch"], 3),
                "compose_loss_update": round(median["step"] - median["floor"] - median["batch"], 3),
            },
            "logo_faces": len(self.logo),
        }

    def _warm_up_steps(self) -> int:
        sampler = self.batcher.sampler
        views = sampler.pose_count * len(sampler.angles) * sampler.outfit_count
        # Drawn at random, all of n views are met after about n (ln n + 3) draws.
        wanted = 0 if is_fresh(self.settings) else views * (np.log(views) + 3)
        return int(np.ceil(wanted / self.settings.batch)) + 1

    def _milliseconds(self, action: Callable[[], None]) -> float:
        self._wait()
        started = time.perf_counter()
        action()
        self._wait()
        return 1e3 * (time.perf_counter() - started)

    def _wait(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
