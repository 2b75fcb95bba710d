"""Compile the loops that draw: `python -m cloak_core.sources.bodies.first_view`, which tools/setup.sh runs.

numba compiles a loop when it is first called, most of a minute for all of them, and keeps what it made. Done once here,
the first picture of a new installation needs no compiler.
"""

from __future__ import annotations

import time

import numpy as np
import torch

from cloak_core.core.cameras import Camera
from cloak_core.core.logo import make_logo
from cloak_core.core.paint import compose
from cloak_core.core.settings.components import PatternSettings
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.core.worn import Worn
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.bodies.view_cache import ViewCache

CAMERA = Camera(width=96, height=96)


def compile_loops() -> float:
    """Draw a small view in each way that there is: by samples and by area, on faces and on a cloth. Returns seconds."""
    started = time.perf_counter()
    bodies = sample_bodies().select_poses([0])
    logo = make_logo(bodies, np.flatnonzero(bodies.regions["chest"]).astype(np.int64))
    for samples in (1, 4, None):
        for pattern in ("free", "tile"):
            worn = Worn.of(PatternSettings(pattern=pattern), bodies, logo)
            cache = ViewCache(bodies, RenderSettings(samples=samples), on_cloth=worn.cloth is not None)
            view = worn.on_body(cache.bake(0, CAMERA, logo.face_ids), np.random.default_rng(0))
            colors = torch.full((worn.color_count, 3), 0.5, requires_grad=True)
            behind = torch.zeros(1, 3, CAMERA.height, CAMERA.width)
            compose([view], colors, behind, torch.tensor([[3, 2]])).sum().backward()
    return time.perf_counter() - started


if __name__ == "__main__":
    print(f"loops compiled in {compile_loops():.0f} s")
