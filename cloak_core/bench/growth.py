"""`cloak bench growth`: how time and memory grow with what there is of something.

Each series multiplies one quantity. Triangles, views, pixels and samples leave the others at the paper's setting (about
55,000 triangles, one view, 416 x 416) and at the default way to measure coverage; the series of samples counts them.
People, detectors and squares of a cloth are measured in training (`growth_training`). The exponent is the slope of
log(time) over log(quantity), fitted to the last three points, where fixed costs have faded. Times are medians of three,
one run from 64 views on. Views are kept, as training keeps them, within the budget. Memory is what a fresh process for
each point held at most, and how much of that came with building (Linux only).
"""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
import trimesh

from cloak_core.bench.growth_training import grow_people, grow_step
from cloak_core.bench.measuring import check_counts, machine, with_earlier
from cloak_core.core.cameras import Camera
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json
from cloak_core.jobs.job import Tell
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.studies.pace import in_turn

_log = logging.getLogger(__name__)

SIZES = {
    "triangles": (10_000, 40_000, 160_000, 640_000, 2_560_000, 5_000_000),
    "views": (1, 4, 16, 64, 256, 512),
    "pixels": (208, 416, 832, 1664),
    "samples": (1, 4, 16, 64),
    "detectors": (1, 2, 4, 8, 16),
    "squares": (100, 400, 1_600, 6_400, 25_600),
    "people": (100, 300, 1_000, 3_000, 10_000),
}
PAPER = {"triangles": 55_000, "views": 1, "pixels": 416, "samples": None}
"""What a view is built of where its series does not say otherwise; pixels along a side."""


def run_bench_growth(
    threads: int = 2,
    memory: int = 2 << 30,
    quick: bool = False,
    only: tuple[str, ...] = (),
    out: str | os.PathLike | None = None,
    people: tuple[str, Path | None] | None = None,
    most: int | None = None,
    tell: Tell = _log.info,
) -> dict:
    """Times, peaks and exponents of every series, or of `only` some; `tell` hears of each point and series.

    memory: bytes for kept views; quick: leave out the largest sizes, as `most` does those above it; people: a COCO
    file, and its photographs' folder, of whom the people of that series are made. With `out`, also growth.json in
    that folder, after each series; series measured there earlier stay beside these.
    """
    if unknown := [name for name in only if name not in SIZES]:
        raise InputError(f"growth: no series '{unknown[0]}'; there are {', '.join(SIZES)}")
    if memory < 1:
        raise InputError(f"growth: {memory} bytes for views: at least 1")
    check_counts(1, threads)
    if "people" in only and people is None:
        raise InputError("growth: --only people needs --people, of whom others are made")
    series = {}
    for quantity in only or tuple(name for name in SIZES if name != "people" or people):
        sizes = SIZES[quantity][: max(3, len(SIZES[quantity]) - 2)] if quick else SIZES[quantity]
        sizes = [size for size in sizes if most is None or size <= most]
        if len(sizes) < 2:
            raise InputError(f"growth: --most {most} leaves fewer than two sizes of {quantity}, from {sizes or 'none'}")
        power = 2 if quantity == "pixels" else 1
        turns = in_turn(sizes, f"{quantity}: {{:,}}".format, tell, weight=lambda size, power=power: size**power)
        points = [measure(quantity, size, threads, memory, people) for size in turns]
        fitted = exponents(points, power)
        series[quantity] = {**fitted, "points": points, "threads": threads, "memory": memory, "machine": machine()}
        if out is not None:
            Path(out).mkdir(parents=True, exist_ok=True)
            series = with_earlier(Path(out, "growth.json"), "series", series, SIZES)
        result = {"exponents": {name: record["exponent"] for name, record in series.items()}, "series": series}
        if out is not None:
            write_json(Path(out, "growth.json"), result)
        tell(f"{quantity}: time grows with exponent {fitted['exponent']:.2f}")
    return result


def exponents(points: list[dict], power: int = 1) -> dict[str, float]:
    """Compute the slopes of log(time) and log(memory) over log(size to the `power`), over the last three points."""
    size, seconds, memory = (np.log([p[key] for p in points[-3:]]) for key in ("size", "seconds", "working_mib"))
    time, space = (float(np.polyfit(power * size, values, 1)[0]) for values in (seconds, memory))
    return {"exponent": time, "memory_exponent": space}


def measure(quantity: str, size: int, threads: int, memory: int, people: tuple[str, Path | None] | None = None) -> dict:
    """Measure one point, in a process of its own, so that its peak of memory is its own."""
    try:
        with ProcessPoolExecutor(1, get_context("spawn")) as process:
            return {"size": size} | process.submit(_point, quantity, size, threads, memory, people).result()
    except BrokenProcessPool as error:
        raise InputError(f"growth: the point of {size:,} {quantity} failed: {error}") from None


def sphere(triangles: int, radius: float = 0.9) -> Bodies:
    """Make a closed sphere of about this many triangles."""
    rings = max(3, round(math.sqrt(triangles / 4)))
    solid = trimesh.creation.uv_sphere(radius, count=[rings + 1, rings])
    return Bodies(vertices=solid.vertices[None], triangles=solid.faces)


def _point(
    quantity: str, size: int, threads: int, memory: int, people: tuple[str, Path | None] | None
) -> dict[str, float]:
    """Measure a point in this process: "seconds", memory and what else its series tells."""
    torch.set_num_threads(threads)
    if quantity == "people":
        return _with_memory(lambda: grow_people(size, *people))
    if quantity in ("detectors", "squares"):
        return _with_memory(lambda: grow_step(**{quantity: size}))
    shown = PAPER | {quantity: size}
    camera = Camera(distance=2.2, width=shown["pixels"], height=shown["pixels"])
    keys = [(0, replace(camera, azimuth=360.0 * i / shown["views"])) for i in range(shown["views"])]
    settings = RenderSettings(samples=shown["samples"], memory_bytes=memory)

    def ready(triangles: int) -> ViewCache:
        cache = ViewCache(sphere(triangles), settings)
        cache.screen(keys[:1])  # what is done once for each pose
        return cache

    _build(ready(1000), keys[:1])  # what is done once for each process
    cache = ready(shown["triangles"])
    figures = _with_memory(lambda: {"seconds": _build(cache, keys)})
    times = [figures["seconds"]]
    for _ in range(2 if shown["views"] < 64 else 0):
        times.append(_build(ready(shown["triangles"]), keys))
    return figures | {"seconds": float(np.median(times))}


def _build(cache: ViewCache, keys: list) -> float:
    """Time, in seconds, building and keeping all views, part by part."""
    start = time.perf_counter()
    for part in range(0, len(keys), 16):
        cache.views(keys[part : part + 16])
    return time.perf_counter() - start


def _with_memory(work: Callable[[], dict[str, float]]) -> dict[str, float]:
    """Do the work, and add the MiB that this process held at most meanwhile, and how much of that it took for it."""

    def resident(key: str) -> float:
        with open("/proc/self/status", encoding="ascii") as file:
            return next(int(line.split()[1]) for line in file if line.startswith(key)) / 1024

    before = resident("VmRSS")
    with open("/proc/self/clear_refs", "w", encoding="ascii") as file:
        file.write("5")  # the peak starts anew from what is resident now
    figures = work()
    peak = resident("VmHWM")
    return figures | {"working_mib": max(peak - before, 1.0), "peak_mib": peak}
