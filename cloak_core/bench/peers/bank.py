"""Views of a scene whose visibility comes from a peer; everything after it is ours."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator, Sequence

import numpy as np
import torch

from cloak_core.bench.peers.embree import Embree
from cloak_core.bench.peers.mitsuba import Mitsuba
from cloak_core.bench.peers.open3d import Open3D
from cloak_core.bench.peers.opengl import OpenGL
from cloak_core.bench.peers.protocol import Peer, Target
from cloak_core.bench.reference import closed_outward
from cloak_core.render.covering import DEPTH_BITS, ID_BITS, Window
from cloak_core.render.projection import Screen
from cloak_core.render.rasterizer import EMPTY, Visibility, bounding_window
from cloak_core.render.shading import Light
from cloak_core.render.views import GRIDS, ViewBank
from cloak_core.scene.cameras import Camera
from cloak_core.scene.exchange import Bodies

PEERS: tuple[type[Peer], ...] = (Embree, Mitsuba, OpenGL, Open3D)


def available() -> dict[str, str]:
    """Each peer's version, or in words why it cannot be used here."""
    return {kind.module: _state(kind) for kind in PEERS}


def usable(states: dict[str, str]) -> Iterator[type[Peer]]:
    """The peers that `available` gave a version for."""
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


class PeerBank(ViewBank):
    """A `ViewBank` of one pose that asks a peer what is seen."""

    def __init__(self, bodies: Bodies, light: Light, samples: int, peer: Peer) -> None:
        super().__init__(bodies, light, samples)
        self.peer, self._closed = peer, closed_outward(bodies)

    def pose(self) -> None:
        """Hand the first pose to the peer, as is done for each new pose."""
        self.peer.pose(np.ascontiguousarray(self.bodies.vertices[0], np.float32))

    def visibility(
        self, wanted: Sequence[tuple[int, Camera]], screen: Screen, window: Window | None = None
    ) -> Visibility:
        """The peer's answer; the keys hold no depth."""
        target = self.target(wanted[0][1], screen, window)
        self.peer.aim(target)
        ids = torch.from_numpy(np.ascontiguousarray(self.peer.look())).to(torch.int64)
        keys = torch.where(ids < 0, EMPTY, ids | (((1 << DEPTH_BITS) - 1) << ID_BITS)).unsqueeze(0)
        return Visibility(keys, target.window, target.camera.width, target.camera.height, target.n)

    def target(self, camera: Camera, screen: Screen, window: Window | None = None) -> Target:
        """The view as peers take it."""
        vertices = self.bodies.vertices[0].astype(np.float64)
        pivot = camera.pivot or tuple(((vertices.min(0) + vertices.max(0)) / 2).tolist())
        cull = self._closed and bool((screen.view[2] >= screen.near).all())
        return Target(camera, pivot, GRIDS[self.samples], window or bounding_window(screen), cull)
