"""What the skin that was left out would have shown: the clothed people rendered over their whole bodies."""

from __future__ import annotations

import time

import numpy as np
from jaxtyping import Bool, Integer

from cloak_core.core.cameras import Camera
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.view_cache import ViewCache
from tools.pretrain.clothing.draping import Person, skinned
from tools.pretrain.clothing.garments import Garment

CAMERAS = tuple(Camera(azimuth=azimuth, elevation=up) for azimuth in range(0, 360, 60) for up in (0, 25))
POSES = (0, 3, 6)
"""Of each clip."""


def hidden_seen(
    person: Person, clip: dict[str, np.ndarray], garments: list[Garment], bare: Bool[np.ndarray, " N"]
) -> tuple[list[float], list[float], list[float]]:
    """For each of `CAMERAS` x `POSES`: the share of what is seen that is hidden skin, and the seconds that the view
    takes with the whole skin and with the `bare` polygons alone."""
    skin = skinned(person.rest, person.weights, clip["turned"], clip["offsets"])
    vertices = np.concatenate([skin, *(clip[g.name] for g in garments)], axis=1).astype(np.float32)[list(POSES)]
    starts = skin.shape[1] + np.cumsum([0] + [len(g.vertices) for g in garments])
    worn = [g.quads + start for g, start in zip(garments, starts, strict=False)]
    hidden = np.flatnonzero(~bare)
    whole, whole_took = _faces_seen(vertices, np.concatenate([person.quads, *worn]))
    _, bare_took = _faces_seen(vertices, np.concatenate([person.quads[bare], *worn]))
    return [seen[hidden].sum() / seen.sum() for seen in whole], whole_took, bare_took


def _faces_seen(vertices: np.ndarray, quads: Integer[np.ndarray, "F 4"]) -> tuple[list[np.ndarray], list[float]]:
    """In each view: how much of every face is seen, pixels under the light; and how long the view took, seconds."""
    triangles = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    view_cache = ViewCache(Bodies(vertices, triangles, np.repeat(np.arange(len(quads)), 2)), RenderSettings(samples=4))
    seen, took = [], []
    for pose in range(len(vertices)):
        for camera in CAMERAS:
            start = time.process_time()
            (view,) = view_cache.build([(pose, camera)])
            took.append(time.process_time() - start)
            seen.append(np.bincount(view.face.numpy(), view.weight.numpy(), len(quads)))
    return seen, took
