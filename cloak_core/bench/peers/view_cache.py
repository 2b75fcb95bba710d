"""Views of a scene whose visibility comes from a peer; everything after it is ours."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import torch

from cloak_core.bench.peers.embree import Embree
from cloak_core.bench.peers.mitsuba import Mitsuba
from cloak_core.bench.peers.open3d import Open3D
from cloak_core.bench.peers.opengl import OpenGL
from cloak_core.bench.peers.protocol import Peer, Target
from cloak_core.bench.reference import closed_outward
from cloak_core.exchange.bodies import Bodies
from cloak_core.render.packing import DEPTH_BITS, EMPTY, ID_BITS
from cloak_core.render.rasterizer import bounding_window
from cloak_core.render.settings import Light, RenderSettings
from cloak_core.render.types import Screen, View, Visibility, Window
from cloak_core.render.view_cache import ViewCache
from cloak_core.scene.cameras import Camera

PEERS: tuple[type[Peer], ...] = (Embree, Mitsuba, OpenGL, Open3D)


def available() -> dict[str, str]:
    """Each peer's version, or in words why it cannot be used here."""
    return {kind.module: _state(kind) for kind in PEERS}


def usable(states: dict[str, str]) -> Iterator[type[Peer]]:
    """List the peers that `available` gave a version for."""
    return (kind for kind in PEERS if not states[kind.module].startswith("missing"))


def _state(kind: type[Peer]) -> str:
    one = np.array([[0, 1, 2]])
    try:
        kind(one, 1).pose(np.eye(3, dtype=np.float32))
        return importlib.metadata.version(kind.module)
    except ImportError as error:
        return f"missing: {error}"
    except Exception as error:  # a library behind the package: libGL, libLLVM, a driver
        return f"missing: {type(error).__name__}: {error}"


class PeerViewCache(ViewCache):
    """A `ViewCache` of one pose that asks a peer what is seen, one view at a time."""

    def __init__(self, bodies: Bodies, light: Light, samples: int, peer: Peer) -> None:
        super().__init__(bodies, RenderSettings(light=light, samples=samples))
        self.peer, self._closed = peer, closed_outward(bodies)
        self._targets: dict[Camera, Target] = {}
        self._seen: Visibility | None = None

    def pose(self) -> None:
        """Hand the first pose to the peer, as is done for each new pose."""
        self.peer.pose(np.ascontiguousarray(self.bodies.vertices[0], np.float32))

    def build(self, wanted: Sequence[tuple[int, Camera]]) -> list[View]:
        """Build views as every cache does; the peer looks once, before the work is cut into parts."""
        self._seen = self.seen(wanted[0][1])
        return super().build(wanted)

    def visibility(
        self, wanted: Sequence[tuple[int, Camera]], screen: Screen, window: Window | None = None
    ) -> Visibility:
        """Select a part of what the peer saw."""
        whole = self._seen.window
        window, n = window or whole, self._seen.grid
        rows, columns = (
            slice(window.y0 - whole.y0, window.y1 - whole.y0),
            slice(window.x0 - whole.x0, window.x1 - whole.x0),
        )
        packed = self._seen.packed[:, rows.start * n : rows.stop * n, columns.start * n : columns.stop * n]
        return replace(self._seen, packed=packed.contiguous(), window=window)

    def seen(self, camera: Camera) -> Visibility:
        """Ask the peer what it sees; without depths."""
        target = self.target(camera)
        self.peer.aim(target)
        ids = torch.from_numpy(np.ascontiguousarray(self.peer.look())).to(torch.int64)
        packed = torch.where(ids < 0, EMPTY, ids | (((1 << DEPTH_BITS) - 1) << ID_BITS)).unsqueeze(0)
        return Visibility(packed, target.window, camera.width, camera.height, target.n)

    def target(self, camera: Camera) -> Target:
        """Describe the camera's view as peers take it: the part of the image that holds the body."""
        if camera not in self._targets:
            screen = self.screen([(0, camera)])
            vertices = self.bodies.vertices[0].astype(np.float64)
            pivot = camera.pivot or tuple(((vertices.min(0) + vertices.max(0)) / 2).tolist())
            cull = self._closed and bool((screen.view[2] >= screen.near).all())
            self._targets[camera] = Target(camera, pivot, self.settings.grid, bounding_window(screen), cull)
        return self._targets[camera]
