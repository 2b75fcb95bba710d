"""`cloak bench stability`: hard cases, each against brute force in exact integers and fractions.

The triangle at every sample must agree with integers, from numba loops and from torch operations; and in cases without
overlap or with overlap on purpose, the area of every triangle in every pixel with fractions. Reported beside it are the
depth's error, in units of its last place, the effect of batch, threads, precision and device (there may be none), and
the time that crowded pixels take.
"""

from __future__ import annotations

import contextlib
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from fractions import Fraction
from functools import partial

import numpy as np
import torch
from torch import Tensor

from cloak_core.bench.measuring import machine
from cloak_core.bench.oracle import (
    covered,
    depth,
    hits,
    pieces,
    plane,
    sample_positions,
    screen_of,
    twin,
    visible_shares,
)
from cloak_core.bench.reference import TwinLight, matrix_of
from cloak_core.bench.stability_cases import CASES, Case, ball, rows
from cloak_core.core.cameras import Camera
from cloak_core.core.evaluation.measure import OnProgress
from cloak_core.core.view import CrowdedPixels, View
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.core.visibility.projection import project
from cloak_core.core.visibility.rasterizer import area_fragments, bounding_window, rasterize
from cloak_core.core.visibility.screen import DEPTH_BITS, GRID
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.view_cache import ViewCache

NEAR = 1e-6
"""Largest difference between areas, as shares of a pixel, and between images, that are to be the same."""


def run_bench_stability(
    grids: tuple[int, ...] = (1, 2),
    seeds: int = 3,
    on_progress: OnProgress = lambda done, total: None,
) -> dict:
    """Run all cases, at 1 and 4 samples per pixel and by area. `mismatches` must be 0."""
    by_case = {}
    worst = Fraction(0)
    total = len(CASES) + len(CHECKS)
    for name, make in CASES.items():
        on_progress(len(by_case), total)
        wrong = count = 0
        for case in (make(np.random.default_rng(seed)) for seed in range(seeds)):
            # By numba's loops, and by the torch operations that other devices run.
            for path in (contextlib.nullcontext, torch_alone):
                with path():
                    wrong += sum(mismatches(case, grid) for grid in grids)
            wrong += area_mismatches(case)
            count += 2 * len(grids) + case.has_areas
            worst = max(worst, depth_error(case))
        by_case[name] = {"cases": count, "mismatches": wrong}
    for name, check in CHECKS.items():
        on_progress(len(by_case), total)
        outcome = check()
        wrong, remark = outcome if outcome is not None else (0, "not run: there is no such device here")
        by_case[name] = {"cases": int(outcome is not None), "mismatches": wrong}
        by_case[name] |= {"remark": remark} if remark else {}
    return {
        **{key: sum(row[key] for row in by_case.values()) for key in ("cases", "mismatches")},
        "max_error_ulp": float(worst),
        "by_case": by_case,
        "machine": machine(),
    }


def mismatches(case: Case, grid: int) -> int:
    """Count samples at which the rasterizer and its twin differ, or whose number of covering triangles is wrong."""
    cull = torch.tensor([case.cull] * len(case.screen.x))
    ours = rasterize(case.screen, case.triangles, grid, cull).triangles().numpy()
    wrong = int((ours != twin(case.screen, case.triangles, grid, cull)).sum())
    if case.cover is not None:
        wrong += int((hits(case.screen, case.triangles, grid, case.front_only) != case.cover).sum())
    return wrong


def area_mismatches(case: Case) -> int:
    """Count areas of triangles in pixels that exact fractions find otherwise, and pixels not covered just once.

    The latter in cases in which every sample is covered once. 0 where a case has no areas to compare.
    """
    if not case.has_areas:
        return 0
    screen = case.screen
    corners = (t[0].tolist() for t in (screen.x, screen.y, screen.inverse_depth))
    size = screen.width, screen.height
    count = case.triangles.shape[1]
    fragments = area_fragments(screen, case.triangles, torch.tensor([case.cull]), bounding_window(screen))
    ours = torch.zeros(screen.width * screen.height, count, dtype=torch.float64)
    ours.view(-1).index_add_(0, fragments.pixel * count + fragments.triangle, fragments.area.double())
    exact = torch.zeros_like(ours)
    for place, share in visible_shares(*corners, case.triangles.T.tolist(), size, GRID, case.cull).items():
        exact[place] = float(share)
    wrong = int(((ours - exact).abs() > NEAR).sum())
    return wrong if case.cover is None else wrong + int(((ours.sum(1) - case.cover).abs() > NEAR).sum())


def depth_error(case: Case, limit: int = 200) -> Fraction:
    """Find the largest difference between a sample's depth and its exact value, in units of the depth's last place."""
    x, y = (t[..., 0] for t in sample_positions(case.screen.width, case.screen.height, 1))
    top = (1 << DEPTH_BITS) - 1
    worst = Fraction(0)
    for piece in pieces(case.screen, case.triangles)[:limit]:
        for row, column in np.argwhere(covered(piece, x, y))[:3]:
            place = int(x[row, column]), int(y[row, column])
            corners = [(Fraction(corner.x), Fraction(corner.y)) for corner in piece.corners]
            across, down, at_zero = plane(corners, [Fraction(corner.inverse_depth) for corner in piece.corners])
            exact = (across * place[0] + down * place[1] + at_zero) * (1 << DEPTH_BITS)
            worst = max(worst, abs((top - depth(piece, *place)) - min(exact, top)))
    return worst


# --- what is checked without a twin: each says how much is wrong, and a remark for the report or nothing

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
    """Count face ids that differ, and weights that do so by more than `NEAR`."""
    return int((first[0] != second[0]).sum()) + sum(_differ(a, b) for a, b in zip(first[1], second[1], strict=True))


def _differ(a: View, b: View) -> int:
    """Weights that differ by more than `NEAR`; all where pixels or faces differ."""
    same = torch.equal(a.pixels.cpu(), b.pixels.cpu()) and torch.equal(a.map.column.cpu(), b.map.column.cpu())
    return int(((a.map.weight.cpu() - b.map.weight.cpu()).abs() > NEAR).sum()) if same else len(a.map)


def batch_and_threads() -> tuple[int, str]:
    """Compare views together on four threads, and one by one on one."""
    with torch_threads(4):
        together = _seen()
    with torch_threads(1):
        return _differences(together, _seen(together=False)), ""


def cuda() -> tuple[int, str] | None:
    """Compare the CPU with CUDA; None where there is no CUDA device."""
    if not torch.cuda.is_available():
        return None
    wrong = _differences(_seen(), _seen(device="cuda")) + hard_cases("cuda")
    return wrong, torch.cuda.get_device_name()


def hard_cases(device: str) -> int:
    """Run all hard cases on the CPU and on a device: count the samples whose depth or triangle is not the same bits."""
    wrong = 0
    for case in (make(np.random.default_rng(seed)) for make in CASES.values() for seed in range(3)):
        cull = torch.tensor([case.cull] * len(case.screen.x))
        tensors = {column.name: getattr(case.screen, column.name) for column in fields(case.screen)}
        moved = {name: value.to(device) for name, value in tensors.items() if isinstance(value, Tensor)}
        there = replace(case.screen, **moved), case.triangles.to(device)
        for grid in (1, 2):
            ours = rasterize(case.screen, case.triangles, grid, cull).packed
            wrong += int((rasterize(*there, grid, cull).packed.cpu() != ours).sum())
    return wrong


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
        for ours, true in zip((view.weight, view.specular[view.pixel]), exact, strict=True):
            error = np.abs(ours.numpy() - true)
            wrong = wrong + int((error > NEAR).sum())
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


SIDE = 416
"""Pixels along each side of the image of a crowded scene."""
Triangles = tuple[np.ndarray, np.ndarray, np.ndarray]
"""x and y in pixels, and inverse depth, of the corners [T, 3]."""


def needles(rng: np.random.Generator, count: int) -> Triangles:
    """Triangles half a pixel wide and some 80 long, anywhere."""
    start = rng.uniform(0, SIDE, (2, count))
    along, across = rng.normal(0, 60, (2, count)), rng.normal(0, 0.5, (2, count))
    x, y = (np.stack([s, s + a, s + w], 1) for s, a, w in zip(start, along, across, strict=True))
    return x, y, rng.uniform(0.1, 1, (count, 3))


def specks(rng: np.random.Generator, count: int) -> Triangles:
    """Triangles anywhere in 3 x 3 pixels, through one another."""
    x, y = rng.uniform(200, 203, (2, count, 3))
    return x, y, rng.uniform(0.1, 1, (count, 3))


def crowded(make: Callable[[np.random.Generator, int], Triangles], count: int) -> tuple[int, str]:
    """Take a scene that exact areas could take hours for: crowded pixels are sampled, which bounds the time.

    Counts pixels covered twice, and one more where the coverage is another than that by 8 x 8 samples per pixel; the
    remark has the time and the sampled pixels.
    """
    x, y, depth = make(np.random.default_rng(0), count)
    snapped_x, snapped_y = (np.rint(t * GRID).astype(np.int64).ravel() for t in (x, y))
    screen = screen_of(snapped_x, snapped_y, depth.ravel(), SIDE, SIDE)
    triangles = torch.arange(x.size).view(-1, 3).T
    begun = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CrowdedPixels)
        fragments = area_fragments(screen, triangles.contiguous(), None, bounding_window(screen))
    seconds = time.process_time() - begun
    sampled = sum(warning.message.pixels for warning in caught)
    coverage = torch.zeros(SIDE * SIDE, dtype=torch.float64).index_add_(0, fragments.pixel, fragments.area.double())
    samples = (rasterize(screen, triangles.contiguous(), 8).triangles() >= 0).double().mean(-1).view(-1)
    some = (coverage > 0) | (samples > 0)
    wrong = int((coverage > 1 + 1e-6).sum()) + int((coverage - samples)[some].abs().mean() > 0.05)
    return wrong, f"{seconds:.1f} s, {sampled} of {int(some.sum())} pixels sampled 64 x 64"


CHECKS: dict[str, Callable[[], tuple[int, str] | None]] = {
    "batch, one thread against four": batch_and_threads,
    "light: float32 against float64": precision,
    "CPU against CUDA": cuda,
    "a million triangles in one pixel": million_in_one_pixel,
    "hostile: 100,000 needles": partial(crowded, needles, 100_000),
    "hostile: 8,000 specks in nine pixels": partial(crowded, specks, 8_000),
}
