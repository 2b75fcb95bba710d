"""What `cloak bench stability` checks without a twin: what batch, threads, device and precision change (nothing may).

Each check returns how much is wrong, and a remark for the report or nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace

import numpy as np
import torch
from torch import Tensor

from cloak_core.bench.oracle import screen_of
from cloak_core.bench.reference import TwinLight, matrix_of
from cloak_core.bench.stability_cases import CASES, ball, rows
from cloak_core.core.cameras import Camera
from cloak_core.core.view import Screen, View
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.core.visibility.projection import project
from cloak_core.core.visibility.rasterizer import rasterize
from cloak_core.core.visibility.screen import GRID
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.view_cache import ViewCache

IMAGE = 1e-6
"""Largest difference between images that are to be the same."""
_LIGHT = Light(position=(1.0, 2.0, 3.0))
_CAMERAS = [Camera(azimuth=a, distance=d, width=64, height=48) for a in (0, 80) for d in (0.4, 2.0)]
_KEYS = [(0, Camera(azimuth=a, distance=4.0, width=64, height=48)) for a in (0, 80)]


def _ids(vertices: Tensor, triangles: Tensor, cameras: Sequence[Camera]) -> Tensor:
    screen = project(vertices.expand(len(cameras), -1, -1), cameras, [(0.0, 0.0, 0.0)] * len(cameras))
    return rasterize(screen, triangles, 2).triangles().cpu()


def _ball() -> Bodies:
    points, triangles = ball(np.random.default_rng(2), 3)
    return Bodies(vertices=points[None], triangles=triangles)


def _seen(together: bool = True, device: str = "cpu") -> tuple[Tensor, list[View]]:
    """Face ids of random triangles, and views of a ball by area and by samples: built together or one by one."""
    rng = np.random.default_rng(0)
    vertices = torch.from_numpy(rng.normal(0, 0.5, (1, 3, 4000)))
    triangles = rows(rng.integers(0, 4000, (4000, 3)))
    vertices, triangles = vertices.to(device), triangles.to(device)
    caches = [ViewCache(_ball(), RenderSettings(samples=samples, device=device)) for samples in (None, 4)]
    if together:
        return _ids(vertices, triangles, _CAMERAS), [view for cache in caches for view in cache.views(_KEYS)]
    ids = torch.cat([_ids(vertices, triangles, [camera]) for camera in _CAMERAS])
    return ids, [cache.view(*key) for cache in caches for key in _KEYS]


def _differences(first: tuple[Tensor, list[View]], second: tuple[Tensor, list[View]]) -> int:
    """Count face ids that differ, and weights that do so by more than `IMAGE`."""
    return int((first[0] != second[0]).sum()) + sum(_differ(a, b) for a, b in zip(first[1], second[1], strict=True))


def _differ(a: View, b: View) -> int:
    """Weights that differ by more than `IMAGE`; all where pixels or faces differ."""
    same = torch.equal(a.pixels.cpu(), b.pixels.cpu()) and torch.equal(a.map.column.cpu(), b.map.column.cpu())
    return int(((a.map.weight.cpu() - b.map.weight.cpu()).abs() > IMAGE).sum()) if same else len(a.map)


def batch_and_threads() -> tuple[int, str]:
    """Compare views together on four threads, and one by one on one."""
    with torch_threads(4):
        together = _seen()
    with torch_threads(1):
        return _differences(together, _seen(together=False)), ""


def loops() -> tuple[int, str]:
    """Compare compiled loops, and the torch operations that other devices run."""
    ours = _seen()
    with torch_alone():
        return _differences(ours, _seen()), ""


def cuda() -> tuple[int, str] | None:
    """Compare the CPU with CUDA; None where there is no CUDA device."""
    if not torch.cuda.is_available():
        return None
    wrong = _differences(_seen(), _seen(device="cuda")) + hard_cases("cuda")
    return wrong, torch.cuda.get_device_name()


def hard_cases(device: str, seeds: int = 3) -> int:
    """Run all hard cases on the CPU and on a device: count the samples whose depth or triangle is not the same bits."""
    wrong = 0
    for make in CASES.values():
        for seed in range(seeds):
            case = make(np.random.default_rng(seed))
            cull = torch.tensor([case.cull] * len(case.screen.x))
            there = _screen_on(case.screen, device), case.triangles.to(device)
            for grid in (1, 2):
                ours = rasterize(case.screen, case.triangles, grid, cull).packed
                wrong += int((rasterize(*there, grid, cull).packed.cpu() != ours).sum())
    return wrong


def _screen_on(screen: Screen, device: str) -> Screen:
    moved = {
        column.name: value.to(device)
        for column in fields(screen)
        if isinstance(value := getattr(screen, column.name), Tensor)
    }
    return replace(screen, **moved)


def float32_input() -> tuple[int, str]:
    """Compare the same numbers handed over in float32 and in float64."""
    bodies = _ball()
    double = replace(bodies, vertices=bodies.vertices.astype(np.float64))
    return _differ(*(ViewCache(b).view(*_KEYS[0]) for b in (bodies, double))), ""


def ties() -> tuple[int, str]:
    """Identical triangles, alone and in a batch: the lowest id, everywhere."""
    corners = torch.tensor([[-2.0, 2.0, 0.0], [-1.5, -1.5, 2.0], [0.0, 0.1, 0.2]], dtype=torch.float64).unsqueeze(0)
    triangles = rows([[1, 2, 0], [0, 1, 2], [2, 1, 0], [0, 2, 1]] * 5)
    cameras = [Camera(azimuth=a, width=16, height=16) for a in (0, 10, 20)]
    seen = [_ids(corners, triangles, cameras), *(_ids(corners, triangles, [camera]) for camera in cameras)]
    return sum(int((ids > 0).sum()) + (not (ids == 0).any()) for ids in seen), ""


def precision() -> tuple[int, str]:
    """Compare light in float32 with its float64 twin, at every visible sample: weights and highlights."""
    bodies = _ball()
    wrong = 0
    worst, ulp = 0.0, 0.0
    cache = ViewCache(bodies, RenderSettings(light=_LIGHT, samples=1))
    for pose, camera in _KEYS:
        view = matrix_of(cache.view(pose, camera), bodies.face_count)
        y, x = (t.numpy() + 0.5 for t in (view.pixel // camera.width, view.pixel % camera.width))
        exact = TwinLight(bodies, camera, _LIGHT)(view.face.numpy(), x.astype(np.float64), y.astype(np.float64))
        for ours, twin in zip((view.weight, view.specular[view.pixel]), exact, strict=True):
            error = np.abs(ours.numpy() - twin)
            wrong = wrong + int((error > IMAGE).sum())
            worst = max(worst, float(error.max()))
        ulp = max(ulp, float((np.abs(view.weight.numpy() - exact[0]) / np.spacing(np.float32(exact[0]))).max()))
    return wrong, f"largest difference {worst:.1e}; of a weight {ulp:.1f} units in the last place"


def million_in_one_pixel() -> tuple[int, str]:
    """Put a million triangles inside one pixel: one is seen at its centre, nothing anywhere else."""
    rng = np.random.default_rng(1)
    corner = rng.integers(2 * GRID, 3 * GRID, (2, 3_000_000))
    screen = screen_of(*corner, rng.uniform(0.1, 0.9, 3_000_000), 5, 5)
    ids = rasterize(screen, torch.arange(3_000_000).view(-1, 3).T.contiguous()).triangles()[0, ..., 0]
    return int(ids[2, 2] < 0) + int((ids >= 0).sum() != 1), ""


def not_finite() -> tuple[int, str]:
    """NaN and both infinities: an error that names the vertex."""
    wrong = 0
    for value in (float("nan"), float("inf"), -float("inf")):
        vertices = torch.zeros(1, 3, 9, dtype=torch.float64)
        vertices[0, 1, 7] = value
        try:
            project(vertices, [Camera()], [(0.0, 0.0, 0.0)])
            wrong += 1
        except InputError as error:
            wrong += "vertex 7" not in str(error)
    return wrong, ""


CHECKS: dict[str, Callable[[], tuple[int, str] | None]] = {
    "batch, one thread against four": batch_and_threads,
    "equal depths go to the lower id in any batch": ties,
    "light: float32 against float64": precision,
    "vertices: float32 against float64": float32_input,
    "compiled loops against torch operations": loops,
    "CPU against CUDA": cuda,
    "a million triangles in one pixel": million_in_one_pixel,
    "NaN and infinity name the vertex": not_finite,
}
