"""Scenes that exact areas could take hours for: crowded pixels are sampled, which bounds the time.

Each check measures one view by area and compares its coverage with 8 x 8 samples per pixel.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
import torch

from cloak_core.bench.oracle import screen_of
from cloak_core.core.view import CrowdedPixels
from cloak_core.core.visibility.rasterizer import area_fragments, bounding_window, rasterize
from cloak_core.core.visibility.screen import GRID

SIDE = 416
"""Pixels along each side of the image."""
NEAR = 0.05
"""Largest mean difference from the coverage by 8 x 8 samples."""
Triangles = tuple[np.ndarray, np.ndarray, np.ndarray]
"""x and y in pixels, and inverse depth, of the corners [T, 3]."""


def needles(rng: np.random.Generator, count: int) -> Triangles:
    """Triangles half a pixel wide and some 80 long, anywhere."""
    start, along, across = (
        rng.uniform(0, SIDE, (2, count)),
        rng.normal(0, 60, (2, count)),
        rng.normal(0, 0.5, (2, count)),
    )
    x, y = (np.stack([s, s + a, s + w], 1) for s, a, w in zip(start, along, across, strict=True))
    return x, y, rng.uniform(0.1, 1, (count, 3))


def hairs(rng: np.random.Generator, count: int) -> Triangles:
    """Cards about a pixel wide that hang from a disc, through one another; two triangles each."""
    angle, radius = rng.uniform(0, 2 * np.pi, count), 60 * np.sqrt(rng.uniform(0, 1, count))
    x, y = 208 + radius * np.cos(angle), 120 + radius * np.sin(angle)
    wide, high, lean = rng.normal(0, 0.8, count), rng.uniform(30, 60, count), rng.normal(0, 6, count)
    left, right = np.stack([x, x + lean, x + lean + wide], 1), np.stack([x, x + lean + wide, x + wide], 1)
    upper, lower = np.stack([y, y + high, y + high], 1), np.stack([y, y + high, y], 1)
    depth = rng.uniform(0.3, 0.6, count)[:, None] + rng.normal(0, 0.01, (2, count, 3))
    return np.concatenate([left, right]), np.concatenate([upper, lower]), depth.reshape(-1, 3)


def planes(rng: np.random.Generator, count: int) -> Triangles:
    """Triangles larger than the image through one point, each at another slant."""
    corner = np.arange(3) * 2 * np.pi / 3 + rng.uniform(0, 2 * np.pi, (count, 1))
    right, down = 2000 * np.cos(corner), 2000 * np.sin(corner)
    slope = rng.normal(0, 1e-4, (2, count, 1))
    return 208.3 + right, 208.7 + down, np.clip(0.5 + slope[0] * right + slope[1] * down, 1e-6, 1)


def specks(rng: np.random.Generator, count: int) -> Triangles:
    """Triangles anywhere in 3 x 3 pixels, through one another."""
    x, y = rng.uniform(200, 203, (2, count, 3))
    return x, y, rng.uniform(0.1, 1, (count, 3))


def check(make: Callable[[np.random.Generator, int], Triangles], count: int) -> tuple[int, str]:
    """Count pixels covered twice, one more where coverage is off; also tell the time and the sampled pixels."""
    x, y, depth = make(np.random.default_rng(0), count)
    snapped_x, snapped_y = (np.rint(t * GRID).astype(np.int64).ravel() for t in (x, y))
    screen, triangles = screen_of(snapped_x, snapped_y, depth.ravel(), SIDE, SIDE), torch.arange(x.size).view(-1, 3).T
    begun = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CrowdedPixels)
        found = area_fragments(screen, triangles.contiguous(), None, bounding_window(screen))
    seconds, sampled = time.process_time() - begun, sum(one.message.pixels for one in caught)
    coverage = torch.zeros(SIDE * SIDE, dtype=torch.float64).index_add_(0, found.pixel, found.area.double())
    samples = (rasterize(screen, triangles.contiguous(), 8).triangles() >= 0).double().mean(-1).view(-1)
    some = (coverage > 0) | (samples > 0)
    wrong = int((coverage > 1 + 1e-6).sum()) + int((coverage - samples)[some].abs().mean() > NEAR)
    return wrong, f"{seconds:.1f} s, {sampled} of {int(some.sum())} pixels sampled 64 x 64"


HOSTILE: dict[str, Callable[[], tuple[int, str]]] = {
    "hostile: 100,000 needles": partial(check, needles, 100_000),
    "hostile: 20,000 hairs": partial(check, hairs, 20_000),
    "hostile: 2,000 planes through a point": partial(check, planes, 2_000),
    "hostile: 8,000 specks in nine pixels": partial(check, specks, 8_000),
}
