"""Compile the loops that draw: `python -m cloak_core.studies.first_view`, which tools/setup.sh runs.

numba compiles a loop when it is first called, most of a minute for all of them, and keeps what it made. Done once here,
the first picture of a new installation needs no compiler.
"""

from __future__ import annotations

import time

import numpy as np
import torch

from cloak_core.core.cameras import Camera
from cloak_core.core.images import dressed
from cloak_core.core.logo import make_logo
from cloak_core.core.settings.components import PatternSettings
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.patterns.choosing import pattern_of
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.bodies.source import BodySource
from cloak_core.sources.photographs.resampling import Kernel, resample, spread_back

CAMERA = Camera(width=96, height=96)


def compile_loops() -> float:
    """Draw a small view in each way that there is: by samples and by area, on faces and on a cloth. Returns seconds."""
    started = time.perf_counter()
    bodies = sample_bodies().select_poses([0])
    logo = make_logo(bodies, np.flatnonzero(bodies.regions["chest"]).astype(np.int64))
    behind = torch.zeros(CAMERA.height * CAMERA.width + 1, 3)
    shown = {"pose": 0, "outfit": 0, "azimuth": 0.0, "elevation": 6.0, "distance": 2.2}
    for samples in (1, 4, None):
        source = BodySource(bodies, RenderSettings(samples=samples), CAMERA)
        for name in ("free", "tile"):
            pattern = pattern_of(PatternSettings(pattern=name), bodies, logo)
            colors = torch.full((pattern.count, 3), 0.5, requires_grad=True)
            view = source.view(shown, 0, pattern)
            dressed([view], pattern, behind, torch.tensor([[3, 2]])).paint(colors).sum().backward()
    kernel = Kernel.of(0.0, 40.0, 32, 40)
    spread_back(resample(torch.zeros(40, 40, 3), kernel, kernel), kernel, kernel)
    return time.perf_counter() - started


if __name__ == "__main__":
    print(f"loops compiled in {compile_loops():.0f} s")
