"""A pose range as long as a film: views are built and dropped, and memory stays within the budget."""

import subprocess
import sys

import numpy as np
import pytest

from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.people.samples import sample_bodies

POSES = 500
BUDGET_MB = 24
CHILD = f"""
import ctypes, gc, tempfile
from dataclasses import replace
from pathlib import Path
import numpy as np
from cloak_core.studies.trainings import training
from cloak_core.sources.bodies import source
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.core.settings import make_settings
from cloak_core.core.logo import make_logo, select_region
from tests.core.fakes import TinyDetector, noise_backgrounds
from tests.core.test_many_poses import many_poses
small = lambda settings: replace(settings, memory_bytes={BUDGET_MB} << 20)
source.ViewCache = lambda bodies, settings, **more: ViewCache(bodies, small(settings), **more)
bodies = many_poses()
logo = make_logo(bodies, select_region(bodies, "chest+thighs"))
quick = dict(batch=8, angles="-10,0,10", size=128, translation=0, checkpoint_every=0, preview_every=0)
held = []
def measure(event):
    if event["type"] != "end":
        return
    gc.collect()
    # Freed memory stays with the process until it is given back; only what is held shall count.
    getattr(ctypes.CDLL(None), "malloc_trim", lambda spare: None)(0)
    held.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20)
with tempfile.TemporaryDirectory() as folder:
    for name, steps in (("warm-up", 24), ("short", 24), ("long", 48)):
        settings = make_settings("best", steps=steps, **quick)
        given = settings, bodies, logo, [TinyDetector()], noise_backgrounds(200), Path(folder) / name
        training.train(*given, on_event=measure)
print(*held)
"""


def many_poses() -> Bodies:
    """500 different bodies between the sample bodies' poses."""
    bodies = sample_bodies("train")
    random = np.random.default_rng(0)
    vertices = np.empty((POSES, *bodies.vertices.shape[1:]), np.float32)
    for pose in vertices:
        a, b = random.choice(bodies.pose_count, 2, replace=False)
        pose[:] = bodies.vertices[a] + random.random() * 0.3 * (bodies.vertices[b] - bodies.vertices[a])
    return Bodies(
        vertices=vertices,
        triangles=bodies.triangles,
        triangle_face=bodies.triangle_face,
        face_colors=bodies.face_colors,
        regions=bodies.regions,
        loop_total=bodies.loop_total,
        loop_vertices=bodies.loop_vertices,
    )


@pytest.mark.long
def test_five_hundred_poses_stay_within_the_budget() -> None:
    """Twice as many views, nearly all of them new, need no more memory once the budget is full."""
    done = subprocess.run([sys.executable, "-c", CHILD], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    _, short, long = map(float, done.stdout.split())
    assert long - short < 2 * BUDGET_MB  # kept without a bound they are six times as much
