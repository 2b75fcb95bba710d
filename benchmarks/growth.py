"""`cloak bench growth`: how time and memory grow with what there is of something.

Each series multiplies one quantity. Triangles, views, pixels and samples leave the others at the paper's setting (about
55,000 triangles, one view, 416 x 416) and at the default way to measure coverage; the series of samples counts them.
People, detectors and squares of a cloth are measured in training. The exponent is the slope of
log(time) over log(quantity), fitted to the last three points, where fixed costs have faded. Times are medians of three,
one run from 64 views on. Views are kept, as training keeps them, within the budget. Memory is what a fresh process for
each point held at most, and how much of that came with building (Linux only).
"""

from __future__ import annotations

import logging
import math
import os
import tempfile
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
from PIL import Image

from benchmarks.records import with_earlier
from cloak_core.bench.measuring import check_counts, machine
from cloak_core.bench.step import Bench
from cloak_core.core.cameras import Camera
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.settings import make_settings
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json
from cloak_core.jobs.job import Tell
from cloak_core.patterns.controls import OwnClothing, controls
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.sources.photographs.annotation import BLAZEPOSE
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import People, Person, load_people
from cloak_core.studies.coco import run_lengths
from cloak_core.studies.opening import clothes_cover
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


# --- what grows in training: people in photographs, detectors that are trained against, squares of a cloth

BATCH = 8
STEPS = 12
"""Timed steps; with people each shows others."""
WORN = 64
"""People who are dressed, spread over all; their time is that of all of them."""
SIZE = 416
LEAST, MOST = 110, 400
"""Heights of simulated people, pixels."""
SHARD = 1000
"""People of one file."""


def grow_people(count: int, people: str, images: Path | None) -> dict[str, float]:
    """Read, fit, train on and dress `count` simulated people, from nothing on disk: seconds of each, and in all.

    read: the first time; again: as the next command reads them; fit: all of them, on all cores; step, floor:
    milliseconds of an update on `BATCH` of them, and of its detector alone; wear: everybody dressed once; disk:
    kilobytes of fits a person.
    """
    seconds: dict[str, float] = {}

    def timed(name: str, action: Callable[[], object]) -> object:
        started = time.perf_counter()
        result = action()
        seconds[name] = time.perf_counter() - started
        return result

    with tempfile.TemporaryDirectory() as folder:
        listed = write_simulated(load_people(people, images), count, Path(folder, "people"))
        os.environ["CLOAK_CACHE"] = str(Path(folder, "cache"))
        everybody = timed("read_s", lambda: load_people(listed))
        timed("again_s", lambda: load_people(listed))
        crowd = Crowd(everybody)
        fits = timed("fit_s", lambda: crowd.fits)
        stored = sum(path.stat().st_size for path in Path(folder, "cache", "fits").iterdir())
        settings = make_settings("photographs", batch=BATCH, size=SIZE, steps=1000)
        bench = Bench(load_scene("sample[0:1]"), None, load_backgrounds("procedural:train:8"), settings, crowd)
        step = bench.measure([load_detector("builtin")], STEPS)
        grey = controls(("grey",), OwnClothing(clothes_cover()))["grey"]
        shown = crowd.images(load_backgrounds("procedural:test:1"), WearSettings(size=SIZE))
        some = np.linspace(0, len(fits) - 1, min(WORN, len(fits))).astype(int).tolist()
        timed("wear_s", lambda: [shown.render([k], grey) for k in some])
        seconds["wear_s"] *= len(fits) / len(some)
        figures = {"step_ms": step["step_ms"], "floor_ms": step["floor_ms"], "disk_kB": stored / len(fits) / 1000}
        return {"seconds": seconds["read_s"] + seconds["fit_s"]} | seconds | figures


def grow_step(detectors: int = 1, squares: int | None = None) -> dict[str, float]:
    """Time a step of training: against this many copies of the embedded detector, or with about this many squares."""
    changes: dict[str, object] = {"batch": 2, "size": 224, "steps": 1000}
    if squares is not None:
        changes |= {"pattern": "tile", "tile_cm": 50.0, "feature_cm": 50.0 / round(math.sqrt(squares))}
    settings = make_settings("best", **changes)
    bench = Bench(load_scene("sample[0:1]"), None, load_backgrounds("procedural:train:8"), settings)
    step = bench.measure([load_detector("builtin") for _ in range(detectors)], STEPS)
    return {"seconds": step["step_ms"] / 1000, "floor_ms": step["floor_ms"]}


def write_simulated(people: People, count: int, folder: Path) -> Path:
    """Write `count` people in COCO's format, `SHARD` a file, and the list of these files, which is returned.

    Each is one of `people`, scaled and recoloured, and has a photograph of her own.
    """
    folder.mkdir(parents=True)
    names = []
    for start in range(0, count, SHARD):
        numbers = range(start, min(start + SHARD, count))
        made = [_simulated(people.people[number % len(people)], number, folder) for number in numbers]
        names.append(f"people-{start // SHARD}.json")
        images, annotations = zip(*made, strict=True)
        write_json(folder / names[-1], {"images": images, "annotations": annotations})
    path = folder / "people.txt"
    path.write_text("\n".join(names) + "\n", encoding="utf-8")
    return path


def _simulated(person: Person, number: int, folder: Path) -> tuple[dict, dict]:
    """Save a scaled and recoloured photograph of a person; COCO's records of the image and of the person."""
    random = np.random.default_rng(number)
    rows = np.flatnonzero(person.mask.any(axis=1))
    scale = float(np.clip(random.uniform(0.7, 1.15), *np.array([LEAST, MOST]) / (rows[-1] + 1 - rows[0])))
    size = round(person.image.shape[1] * scale), round(person.image.shape[0] * scale)
    recolored = np.clip(person.image * random.uniform(0.75, 1.25, 3), 0, 255).astype(np.uint8)
    picture = Image.fromarray(recolored).resize(size, Image.Resampling.BILINEAR)
    picture.save(folder / f"{number}.jpg", quality=90)
    mask = np.array(Image.fromarray(person.mask).resize(size, Image.Resampling.NEAREST))
    y, x = np.nonzero(mask)
    landmarks = person.landmarks.moved((0.0, 0.0), scale)
    points, depth, visibility = np.zeros((33, 2)), np.zeros(33), np.zeros(33)
    points[list(BLAZEPOSE)], visibility[list(BLAZEPOSE)] = landmarks.xy, landmarks.visibility
    if landmarks.depth is not None:
        depth[list(BLAZEPOSE)] = -landmarks.depth
    pose = {"xy": points.ravel(), "visibility": visibility, "z": depth}
    return {"id": number, "file_name": f"{number}.jpg", "width": size[0], "height": size[1]}, {
        "id": number,
        "image_id": number,
        "iscrowd": 0,
        "bbox": [int(x.min()), int(y.min()), int(np.ptp(x)) + 1, int(np.ptp(y)) + 1],
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
        "blazepose": {name: values.round(2).tolist() for name, values in pose.items()},
    }
