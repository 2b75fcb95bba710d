"""What grows in training: people in photographs, detectors that are trained against, squares of a cloth."""

from __future__ import annotations

import math
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from cloak_core.bench.simulated_people import write_simulated
from cloak_core.bench.step import Bench
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.settings import make_settings
from cloak_core.detectors.loading import load_detector
from cloak_core.patterns.controls import OwnClothing, controls
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.photographs.fits import fit_people
from cloak_core.sources.photographs.people import load_people
from cloak_core.studies.imagery import people_images
from cloak_core.studies.opening import clothes_cover

BATCH = 8
STEPS = 12
"""Timed steps; with people each shows others."""
WORN = 64
"""People who are dressed, spread over all; their time is that of all of them."""
SIZE = 416


def grow_people(count: int, people: str, images: Path | None) -> dict[str, float]:
    """Read, fit, train on and dress `count` simulated people, from nothing on disk: seconds of each, and in all.

    read: the first time; again: as the next command reads them; fit: all of them, on all cores; step, floor:
    milliseconds of an update on `BATCH` of them, and of its detector alone; wear: everybody dressed once; disk:
    kilobytes of fits a person.
    """
    with tempfile.TemporaryDirectory() as folder:
        listed = write_simulated(load_people(people, images), count, Path(folder, "people"))
        os.environ["CLOAK_CACHE"] = str(Path(folder, "cache"))
        clock = _Stages()
        everybody = clock.time("read", lambda: load_people(listed))
        clock.time("again", lambda: load_people(listed))
        fits = clock.time("fit", lambda: fit_people(everybody))
        stored = sum(path.stat().st_size for path in Path(folder, "cache", "fits").iterdir())
        settings = make_settings("photographs", batch=BATCH, size=SIZE, steps=1000)
        bench = Bench(load_scene("sample[0:1]"), None, load_backgrounds("procedural:train:8"), settings, fits)
        step = bench.measure([load_detector("builtin")], STEPS)
        grey = controls(("grey",), OwnClothing(clothes_cover()))["grey"]
        images = people_images(fits, load_backgrounds("procedural:test:1"), WearSettings(size=SIZE))
        some = np.linspace(0, len(fits) - 1, min(WORN, len(fits))).astype(int).tolist()
        clock.time("wear", lambda: [images.render([k], grey) for k in some])
        seconds = dict(clock.seconds)
        seconds["wear"] *= len(fits) / len(some)
        figures = {f"{name}_s": value for name, value in seconds.items()}
        figures |= {"step_ms": step["step_ms"], "floor_ms": step["floor_ms"], "disk_kB": stored / len(fits) / 1000}
        return {"seconds": seconds["read"] + seconds["fit"]} | figures


def grow_step(detectors: int, squares: int | None) -> dict[str, float]:
    """Train against copies of the embedded detector, or with a cloth of about so many squares: seconds of a step."""
    changes: dict[str, object] = {"batch": 2, "size": 224, "steps": 1000}
    if squares is not None:
        changes |= {"pattern": "tile", "tile_cm": 50.0, "feature_cm": 50.0 / round(math.sqrt(squares))}
    settings = make_settings("best", **changes)
    bench = Bench(load_scene("sample[0:1]"), None, load_backgrounds("procedural:train:8"), settings)
    step = bench.measure([load_detector("builtin") for _ in range(detectors)], STEPS)
    return {"seconds": step["step_ms"] / 1000, "floor_ms": step["floor_ms"]}


class _Stages:
    """Seconds of named stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def time(self, name: str, action: object) -> object:
        started = time.perf_counter()
        result = action()
        self.seconds[name] = time.perf_counter() - started
        return result
