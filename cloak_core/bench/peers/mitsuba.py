"""Mitsuba's LLVM variant: rays in compiled wavefronts over its own tree."""

from __future__ import annotations

import numpy as np

from cloak_core.bench.peers.protocol import Peer, Target


class Mitsuba(Peer):
    module = "mitsuba"

    def __init__(self, triangles: np.ndarray, threads: int) -> None:
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")
        drjit.set_thread_count(threads)
        self._mitsuba, self._triangles = mitsuba, triangles.astype(np.uint32)

    def pose(self, vertices: np.ndarray) -> None:
        mesh = self._mitsuba.Mesh("body", len(vertices), len(self._triangles))
        values = self._mitsuba.traverse(mesh)
        values["vertex_positions"] = vertices.ravel()
        values["faces"] = self._triangles.ravel()
        values.update()
        self._scene = self._mitsuba.load_dict({"type": "scene", "body": mesh})

    def aim(self, target: Target) -> None:
        origins, directions = target.rays()
        point, vector = self._mitsuba.Point3f(origins.T), self._mitsuba.Vector3f(directions.T)
        self._shape, self._rays = target.shape, self._mitsuba.Ray3f(point, vector)

    def look(self) -> np.ndarray:
        hit = self._scene.ray_intersect_preliminary(self._rays, coherent=True)
        ids = np.array(hit.prim_index).astype(np.int32)
        ids[~np.array(hit.is_valid())] = -1
        return ids.reshape(self._shape)
