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
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch

from cloak_core.bench.growth_training import grow_people, grow_step
from cloak_core.bench.records import with_earlier
from cloak_core.bench.views import machine
from cloak_core.core.cameras import Camera
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json
from cloak_core.jobs.job import Tell
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.studies.pace import in_turn

_log = logging.getLogger(__name__)

_SIZES = {
    "triangles": (10_000, 40_000, 160_000, 640_000, 2_560_000, 5_000_000),
    "views": (1, 4, 16, 64, 256, 512),
    "pixels": (208, 416, 832, 1664),
    "samples": (1, 4, 16, 64),
    "detectors": (1, 2, 4, 8, 16),
    "squares": (100, 400, 1_600, 6_400, 25_600),
    "people": (100, 300, 1_000, 3_000, 10_000),
}


@dataclass(frozen=True)
class Work:
    """One point: the triangles of a sphere, and the cameras that see it."""

    triangles: int = 55_000
    views: int = 1
    side: int = 416
    samples: int | None = None
    detectors: int | None = None
    squares: int | None = None
    people: int | None = None
    source: tuple[str, Path | None] | None = None
    """COCO file of the people that others are made of, and the folder of their photographs."""

    @property
    def camera(self) -> Camera:
        return Camera(distance=2.2, width=self.side, height=self.side)


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
    if unknown := [name for name in only if name not in _SIZES]:
        raise InputError(f"growth: no series '{unknown[0]}'; there are {', '.join(_SIZES)}")
    if threads < 1 or memory < 1:
        raise InputError(f"growth: {threads} threads, {memory} bytes: at least 1 each")
    if "people" in only and people is None:
        raise InputError("growth: --only people needs --people, of whom others are made")
    series = {}
    for quantity in only or tuple(name for name in _SIZES if name != "people" or people):
        field = "side" if quantity == "pixels" else quantity
        sizes = _SIZES[quantity][: max(3, len(_SIZES[quantity]) - 2)] if quick else _SIZES[quantity]
        sizes = [size for size in sizes if most is None or size <= most]
        if len(sizes) < 2:
            raise InputError(f"growth: --most {most} leaves fewer than two sizes of {quantity}, from {sizes or 'none'}")
        work = Work(source=people)
        power = 2 if quantity == "pixels" else 1
        turns = in_turn(sizes, f"{quantity}: {{:,}}".format, tell, weight=lambda size, power=power: size**power)
        points = [_measured(replace(work, **{field: size}), size, threads, memory) for size in turns]
        fitted = exponents(points, power)
        series[quantity] = {**fitted, "points": points, "threads": threads, "memory": memory, "machine": machine()}
        result = _result(series) if out is None else write_report(series, Path(out))
        tell(f"{quantity}: time grows with exponent {fitted['exponent']:.2f}")
    return result


def _result(series: dict) -> dict:
    return {"exponents": {name: record["exponent"] for name, record in series.items()}, "series": series}


def exponents(points: list[dict], power: int = 1) -> dict[str, float]:
    """Compute the slopes of log(time) and log(memory) over log(size to the `power`), over the last three points."""
    size, seconds, memory = (np.log([p[key] for p in points[-3:]]) for key in ("size", "seconds", "working_mib"))
    time, space = (float(np.polyfit(power * size, values, 1)[0]) for values in (seconds, memory))
    return {"exponent": time, "memory_exponent": space}


def write_report(series: dict, folder: Path) -> dict:
    """Write growth.json, with what the folder held before of other series, and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    result = _result(with_earlier(folder / "growth.json", "series", series, _SIZES))
    write_json(folder / "growth.json", result)
    return result


def _measured(work: Work, size: int, threads: int, memory: int) -> dict:
    """Measure one point, in a process of its own, so that its peak of memory is its own."""
    try:
        with ProcessPoolExecutor(1, get_context("spawn")) as process:
            return {"size": size} | process.submit(_run, work, threads, memory).result()
    except BrokenProcessPool as error:
        raise InputError(f"growth: the point {work} failed: {error}") from None


def sphere(triangles: int, radius: float = 0.9) -> Bodies:
    """Make a closed sphere of about this many triangles."""
    rings = max(3, round(math.sqrt(triangles / 4)))
    sectors = 2 * rings
    polar = np.linspace(0, np.pi, rings + 1)[1:-1, None]
    around = (np.arange(sectors) * 2 * np.pi / sectors)[None]
    inner = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)), -1
    )
    vertices = np.concatenate([[[0, 1, 0]], inner.reshape(-1, 3), [[0, -1, 0]]]) * radius
    at = 1 + np.arange((rings - 1) * sectors).reshape(rings - 1, sectors)
    a = at[:-1]
    b, c = np.roll(at, -1, 1)[:-1], np.roll(at, -1, 1)[1:]
    d = at[1:]
    top, bottom = np.zeros(sectors, int), np.full(sectors, len(vertices) - 1)
    fans = [(top, at[0], np.roll(at[0], -1)), (bottom, np.roll(at[-1], -1), at[-1])]
    quads = [(a.ravel(), d.ravel(), c.ravel()), (a.ravel(), c.ravel(), b.ravel())]
    return Bodies(vertices=vertices[None], triangles=np.concatenate([np.stack(t, -1) for t in fans + quads]))


def _run(work: Work, threads: int, memory: int) -> dict:
    torch.set_num_threads(threads)
    if work.people or work.detectors or work.squares:
        return _in_training(work)
    bodies = sphere(work.triangles)
    keys = [(0, replace(work.camera, azimuth=360.0 * i / work.views)) for i in range(work.views)]
    _build(_ready(sphere(1000), work, keys[:1], memory), keys[:1])  # what is done once for each process
    cache = _ready(bodies, work, keys, memory)
    before = _memory("VmRSS")
    _forget_peak()
    times = [_build(cache, keys)]
    peak = _memory("VmHWM")
    for _ in range(2 if work.views < 64 else 0):
        times.append(_build(_ready(bodies, work, keys, memory), keys))
    return {"seconds": float(np.median(times)), "working_mib": max(peak - before, 1.0), "peak_mib": peak}


def _in_training(work: Work) -> dict:
    """Measure a point of a series of training: "seconds" and further figures."""
    before = _memory("VmRSS")
    _forget_peak()
    if work.people:
        figures = grow_people(work.people, *work.source)
    else:
        figures = grow_step(work.detectors or 1, work.squares)
    peak = _memory("VmHWM")
    return {"seconds": figures.pop("seconds"), "working_mib": max(peak - before, 1.0), "peak_mib": peak} | figures


def _ready(bodies: Bodies, work: Work, keys: list, memory: int) -> ViewCache:
    cache = ViewCache(bodies, RenderSettings(samples=work.samples, memory_bytes=memory))
    cache.screen(keys[:1])  # what is done once for each pose
    return cache


def _build(cache: ViewCache, keys: list) -> float:
    """Time, in seconds, building and keeping all views, part by part."""
    start = time.perf_counter()
    for part in range(0, len(keys), 16):
        cache.views(keys[part : part + 16])
    return time.perf_counter() - start


def _memory(key: str) -> float:
    """Read the MiB of this process that are resident now (VmRSS) or were at most (VmHWM)."""
    with open("/proc/self/status", encoding="ascii") as file:
        return next(int(line.split()[1]) for line in file if line.startswith(key)) / 1024


def _forget_peak() -> None:
    """Let VmHWM start anew from what is resident now."""
    with open("/proc/self/clear_refs", "w", encoding="ascii") as file:
        file.write("5")
