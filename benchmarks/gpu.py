"""`cloak bench gpu`: everything that is to be measured on a CUDA device, in one record.

Without such a device nothing is timed: the record says which parts were not run, and what a new view asks of a device
is counted on the CPU, operation by operation.
"""

from __future__ import annotations

import collections
import logging
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from benchmarks.growth import sphere
from cloak_core.bench.detectors import run_bench_detectors
from cloak_core.bench.measuring import machine
from cloak_core.bench.stability import cuda as compare_with_cpu
from cloak_core.bench.step import run_bench_step
from cloak_core.bench.views import run_bench_views
from cloak_core.core.cameras import Camera
from cloak_core.core.settings import make_settings
from cloak_core.core.visibility.compiled import torch_alone, triton_kernels
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json
from cloak_core.jobs.job import Tell
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import load_people
from cloak_core.studies.pace import in_turn

_log = logging.getLogger(__name__)
TRIANGLES = 55_000
"""Of the scene whose views are timed, as many as the paper's body has."""
DEVICE = "cuda"


@dataclass(frozen=True)
class BenchMaterial:
    """What parts measure with."""

    bodies: Bodies
    """Whose first pose views show."""
    people: str | None
    """COCO file of people in photographs."""
    images: Path | None
    """Folder of these photographs."""


class Operations(TorchDispatchMode):
    """Counts torch's operations within, but for views of a tensor: on a device each launches a kernel or more."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: collections.Counter[str] = collections.Counter()

    def __torch_dispatch__(self, func: object, types: object, args: tuple = (), kwargs: dict | None = None) -> object:
        if not func.is_view:
            self.counts[func.overloadpacket.__name__] += 1
        return func(*args, **kwargs or {})


def count_operations(samples: int | None = 1, triangles: int = 3000) -> int:
    """Count the operations of a new view as a device runs them; the count does not depend on the scene.

    samples: a pixel.
    """
    with torch_alone():
        cache = ViewCache(sphere(triangles), RenderSettings(samples=samples))
        cache.build([(0, Camera(width=96, height=96))])  # what is done once
        with Operations() as operations:
            cache.build([(0, Camera(width=96, height=96, azimuth=20.0))])
    return operations.counts.total()


def _launches(material: BenchMaterial) -> dict:
    """Kernels that a new view launches, as the profiler sees them."""
    launches = {}
    for samples in (1, 4):
        cache = ViewCache(material.bodies, RenderSettings(samples=samples, device=DEVICE))
        cache.build([(0, Camera())])
        with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
            cache.build([(0, Camera(azimuth=20.0))])
            torch.cuda.synchronize()
        launches[str(samples)] = sum(event.device_type == torch.autograd.DeviceType.CUDA for event in profile.events())
    return launches


def _plain(material: BenchMaterial) -> dict:
    """The same of views by torch's operations alone, without Triton kernels."""
    with triton_kernels(wanted=False):
        wrong, _ = compare_with_cpu()
        return {
            "against_cpu": wrong,
            "views": run_bench_views(material.bodies, device=DEVICE),
            "launches": _launches(material),
        }


def _step(material: BenchMaterial) -> dict:
    """A step with kept views, with fresh ones, and with people where there are any."""
    bodies, backgrounds = load_scene("sample:train"), load_backgrounds("procedural:train")
    detectors = [load_detector("builtin", device=DEVICE)]
    steps = {}
    for name, changes in {"kept": {}, "fresh": {"distance": "1.8:2.6"}}.items():
        settings = make_settings("best", batch=8, device=DEVICE, **changes)
        steps[name] = run_bench_step(bodies, detectors, backgrounds, settings=settings)
    if material.people is not None:
        settings = make_settings("photographs", batch=8, device=DEVICE)
        people = Crowd(load_people(material.people, material.images))
        steps["people"] = run_bench_step(bodies, detectors, backgrounds, settings=settings, people=people)
    return steps


PARTS: dict[str, Callable[[BenchMaterial], dict]] = {
    # Hard cases and views against the CPU's, which `cloak bench stability` holds to exact arithmetic.
    "bits": lambda material: {"against_cpu": compare_with_cpu()[0]},
    "views": lambda material: run_bench_views(material.bodies, device=DEVICE),
    "launches": _launches,
    "plain": _plain,
    "detectors": lambda material: run_bench_detectors(("builtin",), device=DEVICE),
    "step": _step,
}


def run_bench_gpu(
    people: str | None = None,
    images: Path | None = None,
    scene: str | None = None,
    out: str | os.PathLike | None = None,
    tell: Tell = _log.info,
) -> dict:
    """Measure every part of `PARTS` on the CUDA device, and count what a new view asks of any device.

    people, images: of photographs, for a step with people. scene: whose views are timed; None: a sphere of
    `TRIANGLES`. With `out`, the record goes to that file, after
    each part. "failed" holds the words of parts that ended with bad input; "not_run" says why parts were not run.
    """
    is_there = torch.cuda.is_available()
    record = {
        "machine": machine(DEVICE if is_there else "cpu"),
        "new_view_operations": {str(samples): count_operations(samples) for samples in (1, 4)},
        "measured": {},
        "failed": {},
        "not_run": {} if is_there else dict.fromkeys(PARTS, "no CUDA device"),
    }
    if is_there:
        bodies = sphere(TRIANGLES) if scene is None else load_scene(scene)
        material = BenchMaterial(bodies, people, images)
    for name in in_turn(tuple(PARTS) if is_there else (), str, tell):
        try:
            record["measured"][name] = PARTS[name](material)
        except InputError as error:
            record["failed"][name] = str(error)
        tell(f"{name}: {record['failed'].get(name, 'measured')}")
        if out is not None:
            write_json(Path(out), record)
    if out is not None:
        write_json(Path(out), record)
    return record
