"""Embree through embreex: rays on one thread (a second one gains nothing there)."""

from __future__ import annotations

import numpy as np

from cloak_core.bench.peers.protocol import Peer, Target


class Embree(Peer):
    module = "embreex"

    def __init__(self, triangles: np.ndarray, threads: int) -> None:
        import embreex.mesh_construction
        import embreex.rtcore_scene

        self._scene_of, self._mesh_of = embreex.rtcore_scene.EmbreeScene, embreex.mesh_construction.TriangleMesh
        self._triangles = triangles.astype(np.int32)

    def pose(self, vertices: np.ndarray) -> None:
        self._scene = self._scene_of()
        self._mesh = self._mesh_of(self._scene, vertices, self._triangles)
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # the first ray builds the tree

    def aim(self, target: Target) -> None:
        self._shape, self._rays = target.shape, target.rays()

    def look(self) -> np.ndarray:
        return self._scene.run(*self._rays).reshape(self._shape).astype(np.int32, copy=False)
