"""`cloak bench stability`: hard cases, each against the brute-force twin in exact integers.

What must agree is the triangle at every sample; and, where nothing hides anything and where surfaces overlap on
purpose, the area of every triangle in every pixel, from compiled loops and from torch operations. Beside it stand the
depth's error against exact fractions, in units of the depth's last place, and what batch, threads, precision and device
change (nothing may).
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import torch

from cloak_core.bench.exact import seen_areas
from cloak_core.bench.oracle import Piece, covered, depth, exact_nearness, hits, pieces, sample_positions, twin
from cloak_core.bench.stability_cases import CASES, Case
from cloak_core.bench.stability_checks import CHECKS
from cloak_core.bench.views import machine
from cloak_core.render.compiled import torch_alone
from cloak_core.render.visibility.keys import DEPTH_BITS
from cloak_core.render.visibility.rasterizer import bounding_window, rasterize
from cloak_core.render.weights.fragments import area_fragments

AREA = 1e-6
"""Largest difference, as a share of a pixel, between areas that are to be the same."""


def run_bench_stability(grids: tuple[int, ...] = (1, 2), seeds: int = 3) -> dict:
    """All cases, at 1 and 4 samples per pixel and by area. `mismatches` must be 0."""
    rows, worst = {}, Fraction(0)
    for name, make in CASES.items():
        wrong = count = 0
        for seed in range(seeds):
            case = make(np.random.default_rng(seed))
            count += len(grids)
            wrong += sum(mismatches(case, grid) for grid in grids)
            if case.cover is not None or case.areas:
                count, wrong = count + 2, wrong + area_mismatches(case)
                with torch_alone():
                    wrong += area_mismatches(case)
            worst = max(worst, depth_error(case))
        rows[name] = {"cases": count, "mismatches": wrong}
    for name, check in CHECKS.items():
        found = check()
        wrong, remark = found if found is not None else (0, "not run: there is no such device here")
        rows[name] = {"cases": int(found is not None), "mismatches": wrong} | ({"remark": remark} if remark else {})
    return {
        **{key: sum(row[key] for row in rows.values()) for key in ("cases", "mismatches")},
        "max_error_ulp": float(worst),
        "by_case": rows,
        "machine": machine(),
    }


def mismatches(case: Case, grid: int) -> int:
    """Samples at which the rasterizer and its twin differ, or whose number of covering triangles is wrong."""
    cull = torch.tensor([case.cull] * len(case.screen.x))
    ours = rasterize(case.screen, case.triangles, grid, cull).triangles().numpy()
    wrong = int((ours != twin(case.screen, case.triangles, grid, cull)).sum())
    if case.cover is not None:
        wrong += int((hits(case.screen, case.triangles, grid, case.front_only) != case.cover).sum())
    return wrong


def area_mismatches(case: Case) -> int:
    """Pixels that are not covered just once, in a case where every sample is, and areas of triangles in pixels that
    clipping finds otherwise."""
    screen, count = case.screen, case.triangles.shape[1]
    cull = torch.tensor([case.cull])
    ours, exact = torch.zeros(2, screen.width * screen.height, count, dtype=torch.float64)
    found = area_fragments(screen, case.triangles, cull, bounding_window(screen))
    ours.view(-1).index_add_(0, found.pixel * count + found.triangle, found.area.double())
    seen = seen_areas(screen, case.triangles, case.cull)
    exact.view(-1).index_add_(0, seen.pixel * count + seen.triangle, seen.area)
    wrong = int(((ours - exact).abs() > AREA).sum())
    return wrong if case.cover is None else wrong + int(((ours.sum(1) - case.cover).abs() > AREA).sum())


def depth_error(case: Case, limit: int = 200) -> Fraction:
    """Largest difference between a sample's depth and its exact value, in units of the depth's last place."""
    x, y = (t[..., 0] for t in sample_positions(case.screen.width, case.screen.height, 1))
    worst = Fraction(0)
    for piece in pieces(case.screen, case.triangles)[:limit]:
        for row, column in np.argwhere(covered(piece, x, y))[:3]:
            worst = max(worst, _error_at(piece, int(x[row, column]), int(y[row, column])))
    return worst


def _error_at(piece: Piece, x: int, y: int) -> Fraction:
    top = (1 << DEPTH_BITS) - 1
    exact = min(exact_nearness(piece, x, y) * (1 << DEPTH_BITS), top)
    return abs((top - depth(piece, x, y)) - exact)
