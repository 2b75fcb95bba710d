"""`cloak bench stability`: hard cases, each against brute force in exact integers and fractions.

The triangle at every sample must agree with integers, and in cases without overlap or with overlap on purpose, the area
of every triangle in every pixel with fractions: from numba loops and from torch operations. Reported beside it are the
depth's error, in units of its last place, the effect of batch, threads, precision and device (there may be none), and
the time that crowded pixels take.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import torch

from cloak_core.bench.hostile_cases import HOSTILE
from cloak_core.bench.oracle import (
    Piece,
    covered,
    depth,
    exact_inverse_depth,
    hits,
    pieces,
    sample_positions,
    twin,
    visible_shares,
)
from cloak_core.bench.stability_cases import CASES, Case
from cloak_core.bench.stability_checks import CHECKS
from cloak_core.bench.views import machine
from cloak_core.core.evaluation.measure import OnProgress
from cloak_core.core.visibility.packing import DEPTH_BITS
from cloak_core.core.visibility.rasterizer import area_fragments, bounding_window, rasterize
from cloak_core.core.visibility.screen import GRID

AREA = 1e-6
"""Largest difference, as a share of a pixel, between areas that are to be the same."""


def run_bench_stability(
    grids: tuple[int, ...] = (1, 2),
    seeds: int = 3,
    on_progress: OnProgress = lambda done, total: None,
) -> dict:
    """Run all cases, at 1 and 4 samples per pixel and by area. `mismatches` must be 0."""
    rows = {}
    worst = Fraction(0)
    total = len(CASES) + len(CHECKS) + len(HOSTILE)
    for name, make in CASES.items():
        on_progress(len(rows), total)
        wrong = count = 0
        for seed in range(seeds):
            case = make(np.random.default_rng(seed))
            count += len(grids)
            wrong += sum(mismatches(case, grid) for grid in grids)
            if case.cover is not None or case.areas:
                count, wrong = count + 1, wrong + area_mismatches(case)
            worst = max(worst, depth_error(case))
        rows[name] = {"cases": count, "mismatches": wrong}
    for name, check in {**CHECKS, **HOSTILE}.items():
        on_progress(len(rows), total)
        outcome = check()
        wrong, remark = outcome if outcome is not None else (0, "not run: there is no such device here")
        rows[name] = {"cases": int(outcome is not None), "mismatches": wrong} | ({"remark": remark} if remark else {})
    return {
        **{key: sum(row[key] for row in rows.values()) for key in ("cases", "mismatches")},
        "max_error_ulp": float(worst),
        "by_case": rows,
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

    The latter in cases in which every sample is covered once.
    """
    screen = case.screen
    count = case.triangles.shape[1]
    ours, exact = torch.zeros(2, screen.width * screen.height, count, dtype=torch.float64)
    fragments = area_fragments(screen, case.triangles, torch.tensor([case.cull]), bounding_window(screen))
    ours.view(-1).index_add_(0, fragments.pixel * count + fragments.triangle, fragments.area.double())
    for (pixel, triangle), exact_area in _exact_shares(case).items():
        exact[pixel, triangle] = float(exact_area)
    wrong = int(((ours - exact).abs() > AREA).sum())
    return wrong if case.cover is None else wrong + int(((ours.sum(1) - case.cover).abs() > AREA).sum())


def _exact_shares(case: Case) -> dict[tuple[int, int], Fraction]:
    screen = case.screen
    size = (case.screen.width, case.screen.height)
    corners = (t[0].tolist() for t in (screen.x, screen.y, screen.inverse_depth))
    return visible_shares(*corners, case.triangles.T.tolist(), size, GRID, case.cull)


def depth_error(case: Case, limit: int = 200) -> Fraction:
    """Find the largest difference between a sample's depth and its exact value, in units of the depth's last place."""
    x, y = (t[..., 0] for t in sample_positions(case.screen.width, case.screen.height, 1))
    worst = Fraction(0)
    for piece in pieces(case.screen, case.triangles)[:limit]:
        for row, column in np.argwhere(covered(piece, x, y))[:3]:
            worst = max(worst, _error_at(piece, int(x[row, column]), int(y[row, column])))
    return worst


def _error_at(piece: Piece, x: int, y: int) -> Fraction:
    top = (1 << DEPTH_BITS) - 1
    exact = min(exact_inverse_depth(piece, x, y) * (1 << DEPTH_BITS), top)
    return abs((top - depth(piece, x, y)) - exact)
