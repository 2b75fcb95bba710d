"""`cloak bench views`: what visibility, whole new views, one or a batch, and a cached render of a logo cost."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
import torch

from cloak_core.bench.measuring import check_counts, clock, machine, timed
from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.core.paint import compose
from cloak_core.core.visibility.settings import GRIDS, RenderSettings
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import read_scene
from cloak_core.jobs.job import Tell
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.studies.pace import in_turn

_log = logging.getLogger(__name__)
BATCH = 8
"""Views at once."""


def run_bench_views(
    scene: str | os.PathLike | Bodies,
    samples: int | Literal["area"] | None = None,
    threads: int = 2,
    repeats: int = 20,
    device: str = "cpu",
    camera: Camera | None = None,
    tell: Tell = _log.info,
) -> dict:
    """Time one view at a time, milliseconds (of the clock that `clock` says): median and least of `repeats` runs.

    Visibility is project, cover and depth; a new view is everything a cached render needs, from vertices in memory;
    cached is a render of a chest-and-thighs logo onto a ready
    background together with its gradient. Under by_samples, visibility and new view for every number of samples and for
    coverage by area, and how many times as long `BATCH` views at once take (medians of a quarter of the runs).
    samples: the only way to be timed; None: all of them, 1 in full. `tell` hears of each before it is timed.
    """
    check_counts(repeats, threads)
    bodies = scene if isinstance(scene, Bodies) else read_scene(scene)
    camera = camera or Camera(azimuth=-10.0)
    keys = [(0, replace(camera, azimuth=camera.azimuth + i)) for i in range(BATCH)]

    def cache_of(kind: int | Literal["area"]) -> ViewCache:
        return ViewCache(bodies, RenderSettings(samples=None if kind == "area" else kind, device=device))

    def one_and_many(kind: int | Literal["area"]) -> dict[str, float]:
        cache, result = cache_of(kind), {}
        for name, work in (("visibility", cache.visible), ("new_view", cache.build)):
            single, batch = (
                timed(partial(work, some), max(3, repeats // 4), device, warm_up=2)["median"]
                for some in (keys[:1], keys)
            )
            result |= {f"{name}_ms": single, f"{name}_batch_ratio": batch / single}
        return result

    with torch_threads(threads):
        kinds = (*GRIDS, "area") if samples is None else (samples,)
        tell(f"{repeats} repetitions of everything at {samples or 1} a pixel")
        cache = cache_of(samples or 1)
        return {
            "visibility_ms": timed(lambda: cache.visible(keys[:1]), repeats, device),
            "new_view_ms": timed(lambda: cache.build(keys[:1]), repeats, device),
            "cached_ms": timed(cached_render(cache, camera), repeats, device),
            "by_samples": {
                str(kind): one_and_many(kind) for kind in in_turn(kinds, "samples a pixel: {}".format, tell)
            },
            "samples": samples or 1,
            "threads": threads,
            "clock": clock(device),
            "machine": machine(device),
        }


def cached_render(cache: ViewCache, camera: Camera) -> Callable[[], None]:
    """Prepare one render of the logo onto a ready background with its gradient, to be called again and again.

    Ready as training has it: background and incoming gradient lie channels-last in memory, as images do here.
    """
    faces = chest_and_thighs(cache.bodies)
    view = cache.bake(0, camera, faces)
    generator = torch.Generator().manual_seed(0)
    shape = (1, 3, camera.height, camera.width)
    background, upstream = (
        torch.rand(shape, generator=generator).to(cache.device, memory_format=torch.channels_last) for _ in range(2)
    )
    colors = torch.full((len(faces), 3), 0.5, device=cache.device, requires_grad=True)

    def render() -> None:
        colors.grad = None
        compose([view], colors, background).backward(upstream)

    return render


def chest_and_thighs(bodies: Bodies) -> np.ndarray:
    """Choose the faces [L] of the logo to measure with: the named region, or by height on a standing body.

    An upright body carries its chest at 0.66 to 0.82 of its height and its thighs at 0.3 to 0.48; the front is what
    faces +z.
    """
    if "chest_thighs" in bodies.regions:
        return np.nonzero(bodies.regions["chest_thighs"])[0]
    level = face_centres(bodies)[:, 1]
    low, high = bodies.vertices[0][:, 1].min(), bodies.vertices[0][:, 1].max()
    level = (level - low) / max(high - low, 1e-9)
    chosen = ((level > 0.66) & (level < 0.82)) | ((level > 0.3) & (level < 0.48))
    chosen &= face_normals(bodies)[:, 2] > 0
    return np.flatnonzero(chosen if chosen.any() else ~chosen)
