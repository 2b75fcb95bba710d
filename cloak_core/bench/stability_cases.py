"""The hard cases of `cloak bench stability`: triangles on a screen, each made from a seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from torch import Tensor

from cloak_core.bench.oracle import screen_of
from cloak_core.core.cameras import Camera
from cloak_core.core.view import Screen
from cloak_core.core.visibility.projection import project
from cloak_core.core.visibility.screen import GRID, GUARD

HALF = GRID // 2


@dataclass(frozen=True)
class Case:
    """Triangles on a screen, and how many triangles must cover each sample (None: any number).

    areas: whether areas are compared although triangles overlap.
    """

    screen: Screen
    triangles: Tensor
    cover: int | None = None
    front_only: bool = False
    cull: bool = False
    areas: bool = False

    @property
    def has_areas(self) -> bool:
        """Whether areas are compared: nothing overlaps, or it does so on purpose."""
        return self.cover is not None or self.areas


def rows(array: object) -> Tensor:
    """Triangles listed one by one as [3, T]."""
    return torch.as_tensor(np.asarray(array, np.int64).reshape(-1, 3)).T.contiguous()


def _snapped(
    x: object, y: object, inverse_depth: object, triangles: object, size: tuple[int, int] = (8, 8), **more
) -> Case:
    return Case(screen_of(np.asarray(x), np.asarray(y), np.asarray(inverse_depth), *size), rows(triangles), **more)


def _random(rng: np.random.Generator, size: tuple[int, int] = (9, 7), unit: int = 1) -> Case:
    low, high = -3 * GRID // unit, (max(size) + 3) * GRID // unit
    x, y = rng.integers(low, high, (2, 40)) * unit
    return _snapped(x, y, rng.uniform(0.1, 1, 40), rng.integers(0, 40, (60, 3)), size)


def _lattice(rng: np.random.Generator) -> Case:
    """Vertices on sample points and diagonals through them: every sample covered once."""
    n = 11
    offset = int(rng.choice([0, 1, HALF, HALF + 1]))
    x, y = (np.stack(np.meshgrid(np.arange(n), np.arange(n)), -1).reshape(-1, 2) - 1).T * GRID + offset
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = (t.ravel() for t in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    return _snapped(
        x, y, np.full(n * n, 0.5), np.concatenate([np.stack(t, -1) for t in ((a, b, c), (a, c, d))]), cover=1
    )


def _fan(rng: np.random.Generator) -> Case:
    """Huge triangles around one point that covers the screen: no hole, none twice."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, 12))
    angle[::4] = np.arange(3) * np.pi / 2  # level and upright edges through the centre
    angle = np.sort(np.concatenate([angle, np.arange(4) * np.pi / 2 + 0.1]))
    center = int(rng.integers(2, 6)) * GRID + HALF
    x = np.concatenate([[center], np.round(np.cos(angle) * 3000 * GRID).astype(int)])
    y = np.concatenate([[center], np.round(np.sin(angle) * 3000 * GRID).astype(int)])
    ring = np.arange(len(angle))
    triangles = np.stack([np.zeros_like(ring), ring + 1, (ring + 1) % len(ring) + 1], -1)
    return _snapped(x, y, np.full(len(x), 0.5), triangles, cover=1)


def _strips(rng: np.random.Generator) -> Case:
    """A screen of strips through sample points, 0 to 3 grid steps wide and thinner before snapping: no hole, none
    covered twice."""
    at = (np.arange(-4, 14) * GRID + HALF)[:, None] + np.cumsum([0, 0, 0.3, 0.3, 1, 2, 3]) + rng.integers(-3, 4)
    x = np.concatenate([[-40 * GRID], np.round(at.ravel()), [40 * GRID]]).astype(int)
    lean = int(rng.integers(-2, 3)) * 10 * GRID // 2
    count = len(x)
    y = np.repeat([-GRID, 9 * GRID], count)
    a = np.arange(count - 1)
    halves = ((a, a + 1, a + 1 + count), (a, a + 1 + count, a + count))
    triangles = np.concatenate([np.stack(t, -1) for t in halves])
    return _snapped(np.concatenate([x, x + lean]), y, np.full(2 * count, 0.5), triangles, cover=1)


def _degenerate(rng: np.random.Generator) -> Case:
    """Points, lines, duplicates in every order of corners, inverted ones."""
    corner = rng.integers(0, 8, (2, 6)) * GRID + HALF
    orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]]
    same = [[a[i] for i in rng.permutation(orders)[0]] for a in ([0, 1, 2], [3, 4, 5], [0, 1, 2], [3, 4, 5], [1, 2, 0])]
    return _snapped(*corner, rng.uniform(0.1, 1, 6), [[0, 0, 0], [1, 1, 4], *same, *orders])


def _coplanar(rng: np.random.Generator) -> Case:
    """Overlapping triangles of one plane: whichever is nearer after rounding, the twin says the same."""
    x, y = rng.integers(-2 * GRID, 10 * GRID, (2, 40))
    return _snapped(x, y, 0.5 + x / (60.0 * GRID) + y / (90.0 * GRID), rng.integers(0, 40, (60, 3)))


def _equal_depths(rng: np.random.Generator) -> Case:
    x, y = rng.integers(-2 * GRID, 10 * GRID, (2, 30))
    return _snapped(x, y, np.full(30, rng.uniform(0.1, 1)), rng.integers(0, 30, (80, 3)))


def _far_corners(rng: np.random.Generator) -> Case:
    start = rng.integers(-GUARD // 2, GUARD // 2, (2, 30))
    end = rng.integers(0, 8 * GRID, (2, 30)) - start
    x, y = np.concatenate([start, end, end + rng.integers(-9 * GRID, 9 * GRID, (2, 30))], 1)
    return _snapped(x, y, rng.uniform(0.1, 1, 90), np.arange(90).reshape(3, 30).T)


def _space(rng: np.random.Generator, spread: float, camera: Camera, flatten: float = 1.0, scale: float = 1.0) -> Case:
    """Random triangles in space, projected."""
    points = rng.normal(0, spread, (3, 30)) * np.array([[1.0], [flatten], [1.0]]) * scale
    screen = project(torch.from_numpy(points).unsqueeze(0), [camera], [(0.0, 0.0, 0.0)])
    return Case(screen, rows(rng.integers(0, 30, (40, 3))))


def ball(rng: np.random.Generator, levels: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Make a closed, convex, outward body, randomly oriented: a subdivided icosahedron. Vertices [V, 3], triangles."""
    solid = trimesh.creation.icosphere(subdivisions=levels)
    turn = np.linalg.qr(rng.normal(0, 1, (3, 3)))[0]
    return solid.vertices @ (turn * np.linalg.det(turn)), solid.faces


def _closed(rng: np.random.Generator) -> Case:
    """Fill the image with a convex body: its front covers every sample exactly once."""
    points, triangles = ball(rng)
    camera = Camera(distance=3.0, field_of_view=20.0, width=16, height=16)
    screen = project(torch.from_numpy(points.T.copy()).unsqueeze(0), [camera], [(0.0, 0.0, 0.0)])
    return Case(screen, rows(triangles), cover=1, front_only=True, cull=True)


def _one_pixel(rng: np.random.Generator) -> Case:
    x, y = rng.integers(2 * GRID, 3 * GRID, (2, 3000))
    return _snapped(x, y, rng.uniform(0.1, 1, 3000), np.arange(3000).reshape(-1, 3), (4, 4))


def _sheets(rng: np.random.Generator) -> Case:
    """Large triangles through one another."""
    x, y = rng.integers(-2 * GRID, 7 * GRID, (2, 42))
    return _snapped(x, y, rng.uniform(0.1, 1, 42), np.arange(42).reshape(-1, 3), (5, 4), areas=True)


def _layers(rng: np.random.Generator) -> Case:
    """Level rectangles on quarters of pixels, some at equal depths: they overlap just as much as they leave open."""
    left, top = rng.integers(0, 14, (2, 16, 1)) * (GRID // 4)
    x, y = left + np.array([0, 2, 2, 0]) * (GRID // 2), top + np.array([0, 0, 2, 2]) * (GRID // 2)
    corners = 4 * np.arange(16)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    depth = np.repeat(rng.choice([0.25, 0.5, 0.75], 16), 4)
    return _snapped(x.ravel(), y.ravel(), depth, corners, (5, 5), areas=True)


def _shell(rng: np.random.Generator, cull: bool = True) -> Case:
    """Put a convex body a ten-thousandth within another."""
    points, triangles = ball(rng)
    both = np.concatenate([points, points * 1.0001])
    screen = project(
        torch.from_numpy(both.T.copy()).unsqueeze(0), [Camera(distance=5.0, width=9, height=9)], [(0.0,) * 3]
    )
    return Case(screen, rows(np.concatenate([triangles, triangles + len(points)])), cull=cull, areas=True)


def _hostile(rng: np.random.Generator) -> Case:
    """Strips of a few grid units, twins, folds, corners of pixels and triangles of thousands of pixels, all at once."""
    x, y = rng.integers(0, 4, (2, 60)) * GRID
    thin = slice(0, 20)
    x[thin], y[thin] = rng.integers(0, 4 * GRID, (2, 20))
    x[20:40], y[20:40] = x[thin] + rng.integers(-3, 4, 20), y[thin] + rng.integers(-3, 4, 20)
    x[40:46], y[40:46] = rng.integers(-GUARD // 4, GUARD // 4, (2, 6))
    strips = np.stack([np.arange(20), np.roll(np.arange(20), 1), np.arange(20, 40)], 1)
    others = rng.integers(40, 60, (12, 3))
    triangles = np.concatenate([strips, others, others[:4, [1, 0, 2]], others[4:6]])
    return _snapped(x, y, rng.uniform(0.1, 1, 60), triangles, (4, 4), areas=True)


_AROUND = Camera(distance=1.0, width=8, height=6, field_of_view=70.0, near=0.05)
_SMALL = Camera(width=16, height=12)

CASES: dict[str, Callable[[np.random.Generator], Case]] = {
    "random triangles": _random,
    "corners and edges on samples": lambda rng: _random(rng, unit=HALF // 2),
    "shared edges through samples": _lattice,
    "fans of huge triangles": _fan,
    "slivers: strips of 0 to 3 grid steps and thinner": _strips,
    "degenerate, duplicate, inverted": _degenerate,
    "coplanar overlaps": _coplanar,
    "equal depths": _equal_depths,
    "corners at the guard band": _far_corners,
    "closed mesh": _closed,
    "through the near plane, behind the camera": lambda rng: _space(rng, 1.0, _AROUND),
    "far outside the image": lambda rng: _space(rng, 300.0, _SMALL),
    "grazing view": lambda rng: _space(rng, 0.6, Camera(elevation=0.0, width=16, height=12), flatten=1e-4),
    "scale 1e-6": lambda rng: _space(rng, 0.5, Camera(distance=2.2e-6, width=16, height=12), scale=1e-6),
    "scale 1e6": lambda rng: _space(rng, 0.5, Camera(distance=2.2e6, width=16, height=12), scale=1e6),
    "a thousand triangles in a pixel": _one_pixel,
    "overlap: through one another": _sheets,
    "overlap: aligned layers": _layers,
    "overlap: a thin shell": _shell,
    "overlap: a thin shell, both sides": lambda rng: _shell(rng, cull=False),
    "hostile: strips, twins, folds, giants": _hostile,
    "image 1 x 1": lambda rng: _random(rng, (1, 1)),
    "image 13 x 2": lambda rng: _random(rng, (13, 2)),
    "empty mesh": lambda rng: _snapped([], [], [], [], (3, 2)),
}
