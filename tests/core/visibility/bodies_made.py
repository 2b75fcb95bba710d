"""Small closed bodies for tests, and triangles without any."""

import numpy as np
import torch

from cloak_core.bench.oracle import screen_of
from cloak_core.core.view import Screen
from cloak_core.core.visibility.screen import GRID
from cloak_core.exchange.bodies import Bodies


def sphere(rings: int = 8, sectors: int = 12, radius: float = 1.0, poses: int = 1) -> Bodies:
    """A closed, outward sphere; each further pose is a little larger. Faces in random colours, two outfits."""
    polar = np.linspace(0, np.pi, rings + 1)[1:-1]
    around = np.arange(sectors) * 2 * np.pi / sectors
    ring = np.stack([np.sin(around), np.zeros(sectors), np.cos(around)], -1)
    inner = np.sin(polar)[:, None, None] * ring + np.cos(polar)[:, None, None] * np.array([0.0, 1.0, 0.0])
    vertices = np.concatenate([[[0, 1, 0]], inner.reshape(-1, 3), [[0, -1, 0]]]) * radius
    at = lambda r, s: 1 + r * sectors + s % sectors
    triangles = []
    for s in range(sectors):
        triangles.append((0, at(0, s), at(0, s + 1)))
        triangles.append((len(vertices) - 1, at(rings - 2, s + 1), at(rings - 2, s)))
        for r in range(rings - 2):
            triangles += [(at(r, s), at(r + 1, s), at(r + 1, s + 1)), (at(r, s), at(r + 1, s + 1), at(r, s + 1))]
    colors = np.random.default_rng(0).uniform(0.2, 0.8, (2, len(triangles), 3))
    scale = 1 + 0.1 * np.arange(poses)[:, None, None]
    return Bodies(vertices=vertices * scale, triangles=np.array(triangles), face_colors=colors)


def soup(seed: int, extent: int, count: int, size: tuple[int, int]) -> tuple[Screen, torch.Tensor]:
    """Random triangles between `count` points up to `extent` beyond an image, a third of them on halves of pixels."""
    rng = np.random.default_rng(seed)
    x, y = (rng.integers(-extent, side * GRID + extent, count) for side in size)
    x[::3], y[::3] = x[::3] // (GRID // 2) * (GRID // 2), y[::3] // (GRID // 2) * (GRID // 2)
    return screen_of(x, y, rng.uniform(0.1, 1, count), *size), torch.from_numpy(rng.integers(0, count, (3, 2 * count)))
