"""Every installed peer sees what our rasterizer sees; what is missing is named, never guessed."""

import numpy as np
import pytest

from benchmarks.growth import sphere
from benchmarks.peers import PEERS, PeerViewCache, available
from cloak_core.core.cameras import Camera
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.sources.bodies.view_cache import ViewCache

CAMERAS = {
    "whole": Camera(azimuth=20.0, distance=2.4, width=50, height=40),
    "cut open by the near plane": Camera(azimuth=20.0, distance=1.0, near=0.5, width=50, height=40),
}


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("kind", PEERS, ids=lambda kind: kind.module)
def test_peers_agree_with_the_rasterizer(kind, camera) -> None:
    if (state := available()[kind.module]).startswith("missing"):
        pytest.skip(f"{kind.module} {state}")
    bodies, camera = sphere(1500, 0.7), CAMERAS[camera]
    key = [(0, camera)]
    peer = kind(bodies.triangles.astype(np.int64), 1)
    for samples in (1, 4):
        ours, theirs = ViewCache(bodies, RenderSettings(samples=samples)), PeerViewCache(bodies, Light(), samples, peer)
        theirs.pose()
        a, b = ours.visibility(key, ours.screen(key)).triangles(), theirs.seen(camera).triangles()
        assert (a >= 0).sum() > 300
        # Single precision, and OpenGL's grid of 1/256 pixel, move a few samples that lie on edges.
        assert (a != b).double().mean() < 0.005
        own, other = (cache.build(key)[0] for cache in (ours, theirs))
        assert abs(len(own.map) - len(other.map)) < 0.02 * len(own.map)
