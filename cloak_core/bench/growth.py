"""`cloak bench growth`: how time and memory grow with triangles, views, pixels and samples.

Each series multiplies one quantity and leaves the others; the exponent is the slope of log(time) over log(quantity),
fitted to the last three points, where fixed costs have faded. Memory is the process's own peak, measured in a
fresh process for each point.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from dataclasses import dataclass, replace

import numpy as np

from cloak_core.bench.views import machine
from cloak_core.errors import InputError
from cloak_core.scene.cameras import Camera
from cloak_core.scene.exchange import Bodies

_SIZES = {
    "triangles": (10_000, 40_000, 160_000, 640_000, 2_560_000, 5_000_000),
    "views": (1, 4, 16, 64, 256, 512),
    "pixels": (208, 416, 832, 1664),
    "samples": (1, 4, 16, 64),
}


@dataclass(frozen=True)
class Work:
    """One point: a sphere of so many triangles, seen by so many cameras."""

    triangles: int = 50_000
    views: int = 1
    side: int = 416
    samples: int | None = 1

    @property
    def camera(self) -> Camera:
        return Camera(distance=2.2, width=self.side, height=self.side)


def run_bench_growth(threads: int = 2, memory: int = 2 << 30, quick: bool = False) -> dict:
    """Times, peaks and exponents of every series; `memory`: bytes for kept views; `quick` leaves out the largest."""
    series = {}
    for quantity, sizes in _SIZES.items():
        used = sizes[: max(3, len(sizes) - 2)] if quick else sizes
        series[quantity] = [_measured(_work(quantity, size), size, threads, memory) for size in used]
    exponents = {quantity: exponent(points, 2 if quantity == "pixels" else 1) for quantity, points in series.items()}
    return {"exponents": exponents, "series": series, "threads": threads, "memory": memory, "machine": machine()}


def _work(quantity: str, size: int) -> Work:
    return replace(Work(), **{"side" if quantity == "pixels" else quantity: size})


def exponent(points: list[dict], power: int = 1) -> float:
    """Slope of log(time) over log(size to the `power`), over the last three points."""
    size, seconds = (np.log([p[key] for p in points[-3:]]) for key in ("size", "seconds"))
    return float(np.polyfit(power * size, seconds, 1)[0])


def _measured(work: Work, size: int, threads: int, memory: int) -> dict:
    """One point, in a process of its own, so that its peak of memory is its own."""
    request = json.dumps([work.triangles, work.views, work.side, work.samples, threads, memory])
    command = [sys.executable, "-m", "cloak_core.bench.growth", request]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": str(threads)})
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no output"])[-1]
        raise InputError(f"growth: the point {work} failed: {last}")
    return {"size": size} | json.loads(done.stdout)


def sphere(triangles: int, radius: float = 0.9) -> Bodies:
    """A closed sphere of about so many triangles."""
    rings = max(3, round(math.sqrt(triangles / 4)))
    sectors = 2 * rings
    polar = np.linspace(0, np.pi, rings + 1)[1:-1, None]
    around = (np.arange(sectors) * 2 * np.pi / sectors)[None]
    inner = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)), -1
    )
    vertices = np.concatenate([[[0, 1, 0]], inner.reshape(-1, 3), [[0, -1, 0]]]) * radius
    at = 1 + np.arange((rings - 1) * sectors).reshape(rings - 1, sectors)
    a, b, c, d = at[:-1], np.roll(at, -1, 1)[:-1], np.roll(at, -1, 1)[1:], at[1:]
    top, bottom = np.zeros(sectors, int), np.full(sectors, len(vertices) - 1)
    fans = [(top, at[0], np.roll(at[0], -1)), (bottom, np.roll(at[-1], -1), at[-1])]
    quads = [(a.ravel(), d.ravel(), c.ravel()), (a.ravel(), c.ravel(), b.ravel())]
    return Bodies(vertices=vertices[None], triangles=np.concatenate([np.stack(t, -1) for t in fans + quads]))


def _run(work: Work, threads: int, memory: int) -> dict:
    import resource

    import torch

    from cloak_core.render.views import ViewBank

    torch.set_num_threads(threads)
    bank = ViewBank(sphere(work.triangles), samples=work.samples, memory_bytes=memory)
    keys = [(0, replace(work.camera, azimuth=360.0 * i / work.views)) for i in range(work.views)]
    bank.screen(keys[:1])  # what is done once for each pose
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    times = []
    for _ in range(3 if work.views < 64 else 1):
        start = time.perf_counter()
        for part in bank.batches(keys):
            bank.build(part)
        times.append(time.perf_counter() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"seconds": min(times), "peak_mib": peak / 1024, "peak_above_scene_mib": (peak - before) / 1024}


if __name__ == "__main__":
    *numbers, count, limit = json.loads(sys.argv[1])
    print(json.dumps(_run(Work(*numbers), count, limit)))
