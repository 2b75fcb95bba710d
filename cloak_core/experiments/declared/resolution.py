"""Subdivision levels: success, time, and how many of the logo's faces any training view gives a gradient."""

from __future__ import annotations

import numpy as np
import torch

from cloak_core.core.cameras import Camera
from cloak_core.core.logo import chest_thighs
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.experiments.declaration import MULTI, Cell, Cells, Experiment, Lines, RunStore
from cloak_core.sources.bodies.meshes.subdivision import subdivide
from cloak_core.sources.bodies.view_cache import ViewCache


def cells(store: RunStore) -> Cells:
    bodies, unseen, faces = store.split.bodies, store.split.unseen, chest_thighs(store.split.bodies)
    for level in range(2 if store.options.quick else 3):
        if level:
            bodies, parent = subdivide(bodies)
            unseen, _ = subdivide(unseen)
            faces = np.flatnonzero(np.isin(parent, faces)).astype(np.int64)
        yield Cell(
            label={"level": level, "logo_faces": len(faces), "reach": gradient_reach(store, bodies, faces)},
            faces=faces,
            training={"bodies": bodies, "angles": MULTI},
            test={"bodies": unseen},
            timed=True,
        )


def gradient_reach(store: RunStore, bodies: Bodies, faces: np.ndarray) -> float:
    """Compute the share of the faces that get a gradient from the first body's training views."""
    settings = RenderSettings(samples=store.options.samples, device=store.options.device)
    view_cache = ViewCache(bodies.select_poses([0]), settings)
    seen = torch.zeros(len(faces), dtype=torch.bool, device=view_cache.device)
    for azimuth in (-10.0, -5.0, 0.0, 5.0, 10.0):
        camera = Camera(azimuth=azimuth, width=store.options.size, height=store.options.size)
        seen[view_cache.bake(0, camera, faces).logo_face] = True
    return round(float(seen.float().mean()), 4)


EXPERIMENT = Experiment(
    title="Resolution of the mesh",
    caption="The same logo on bodies subdivided 0, 1, ... times (each face in four). Reach is the share of its faces "
    "that at least one training view sees; processor time, all threads, includes building the views.",
    cells=cells,
    figures={
        "resolution": Lines(
            x="logo_faces", interval="bars", label="success", beside={"reach": "faces with a gradient"}, even=True
        ),
        "time": Lines(x="logo_faces", y="cpu_seconds", interval="", even=True),
    },
    order=8,
)
