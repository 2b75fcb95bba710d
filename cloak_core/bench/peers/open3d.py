"""Open3D's ray casting scene, which is Embree with its own threads."""

from __future__ import annotations

import numpy as np

from cloak_core.bench.peers.protocol import Peer, Target


class Open3D(Peer):
    module = "open3d"

    def __init__(self, triangles: np.ndarray, threads: int) -> None:
        import open3d

        self._open3d, self._threads = open3d, threads
        self._triangles = open3d.core.Tensor(triangles.astype(np.uint32))

    def pose(self, vertices: np.ndarray) -> None:
        self._scene = self._open3d.t.geometry.RaycastingScene(self._threads)
        self._scene.add_triangles(self._open3d.core.Tensor(vertices), self._triangles)
        self._cast(np.ones((1, 6), np.float32))  # the first ray builds the tree

    def aim(self, target: Target) -> None:
        self._shape, self._rays = target.shape, np.concatenate(target.rays(), 1)

    def look(self) -> np.ndarray:
        return self._cast(self._rays).view(np.int32).reshape(self._shape)  # "none" is all ones: -1

    def _cast(self, rays: np.ndarray) -> np.ndarray:
        return self._scene.cast_rays(self._open3d.core.Tensor(rays), self._threads)["primitive_ids"].numpy()
