"""Small closed bodies for tests, and triangles without any."""

import numpy as np
import torch

from cloak_core.bench.oracle import screen_of
from cloak_core.core.view import Screen
from cloak_core.core.visibility.screen import GRID
from cloak_core.exchange.bodies import Bodies
from tests.sources.bodies import solids


def sphere(rings: int = 8, sectors: int = 12, radius: float = 1.0, poses: int = 1) -> Bodies:
    """A closed, outward sphere; each further pose is a little larger. Faces in random colours, two outfits."""
    globe = solids.sphere(sectors, rings - 2)
    colors = np.random.default_rng(0).uniform(0.2, 0.8, (2, globe.triangle_count, 3))
    scale = radius * (1 + 0.1 * np.arange(poses)[:, None, None])
    return Bodies(globe.vertices * scale, globe.triangles, face_colors=colors)


def soup(seed: int, extent: int, count: int, size: tuple[int, int]) -> tuple[Screen, torch.Tensor]:
    """Random triangles between `count` points up to `extent` beyond an image, a third of them on halves of pixels."""
    rng = np.random.default_rng(seed)
    x, y = (rng.integers(-extent, side * GRID + extent, count) for side in size)
    x[::3], y[::3] = x[::3] // (GRID // 2) * (GRID // 2), y[::3] // (GRID // 2) * (GRID // 2)
    return screen_of(x, y, rng.uniform(0.1, 1, count), *size), torch.from_numpy(rng.integers(0, count, (3, 2 * count)))
