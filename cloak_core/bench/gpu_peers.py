"""Rasterizers for CUDA beside ours, where they are installed: nvdiffrast and DRTK.

Each does with one view what a user of it would do in every step of a training of face colours: vertices to the screen,
the nearest triangle of every pixel, its colour, and the colours' gradient. Neither lights anything here.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from functools import partial
from typing import ClassVar

import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from cloak_core.bench.views import timed
from cloak_core.core.cameras import Camera
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.view_cache import ViewCache


class GpuPeer(ABC):
    """A rasterizer of one view. Making one raises `ImportError` where its package is missing."""

    module: ClassVar[str]
    """What is imported; also the peer's name in records."""

    def __init__(self, bodies: Bodies, camera: Camera, device: torch.device) -> None:
        """The first pose, seen by the camera."""
        self.package = importlib.import_module(self.module)
        self.camera = camera
        self.triangles = torch.tensor(bodies.triangles, dtype=torch.int32, device=device)
        pose = torch.tensor(bodies.vertices[0], dtype=torch.float32, device=device)
        pivot = camera.pivot or tuple(((pose.amin(0) + pose.amax(0)) / 2).tolist())
        right, up, back = camera.axes
        axes = torch.tensor([right, up, [-value for value in back]], device=device)
        self.turn = axes.T.contiguous()
        self.move = -(axes @ torch.tensor(camera.position(pivot), device=device))
        self.pose = pose

    def points(self) -> Float32[Tensor, "V 3"]:
        """Move the vertices to view space: right, up, forward, metres."""
        return torch.addmm(self.move, self.pose, self.turn)

    @abstractmethod
    def nearest(self) -> Int64[Tensor, "H W"]:
        """Find the triangle at every pixel's centre, -1 = none."""


class Nvdiffrast(GpuPeer):
    """nvdiffrast's CUDA rasterizer; its rows count from below, so that the picture is turned over on the way there."""

    module = "nvdiffrast.torch"

    def __init__(self, bodies: Bodies, camera: Camera, device: torch.device) -> None:
        super().__init__(bodies, camera, device)
        self.context = self.package.RasterizeCudaContext(device=device)

    def nearest(self) -> Int64[Tensor, "H W"]:
        camera = self.camera
        x, y, z = self.points().unbind(1)
        across = x * (2 * camera.focal / camera.width)
        down = y * (-2 * camera.focal / camera.height)
        place = torch.stack([across, down, z - 2 * camera.near_plane, z], dim=1).unsqueeze(0)
        size = (camera.height, camera.width)
        seen, _ = self.package.rasterize(self.context, place, self.triangles, resolution=size, grad_db=False)
        return seen[0, :, :, 3].long() - 1


class Drtk(GpuPeer):
    """DRTK: the middle of the first pixel is its origin."""

    module = "drtk"

    def nearest(self) -> Int64[Tensor, "H W"]:
        camera = self.camera
        x, y, z = self.points().unbind(1)
        column = camera.focal * x / z + (camera.width - 1) / 2
        row = (camera.height - 1) / 2 - camera.focal * y / z
        place = torch.stack([column, row, z], dim=1).unsqueeze(0)
        return self.package.rasterize(place, self.triangles, camera.height, camera.width)[0].long()


PEERS = (Nvdiffrast, Drtk)


def run_gpu_peers(bodies: Bodies, camera: Camera, device: str = "cuda", repeats: int = 20) -> dict[str, dict]:
    """Time each installed peer on one view, milliseconds, and count its pixels that show what ours do not.

    "visibility" is the nearest triangle of every pixel, "step" that, its colour and the colours' gradient; `other` the
    fraction of pixels, among those where anything is seen, whose triangle is not ours.
    """
    where = torch.device(device)
    cache = ViewCache(bodies, RenderSettings(samples=1, device=device))
    key = [(0, camera)]
    ours = cache.visibility(key, cache.screen(key)).triangles()[0, :, :, 0].long()
    records = {}
    for kind in PEERS:
        try:
            peer = kind(bodies, camera, where)
        except ImportError as error:
            records[kind.module] = {"not_run": str(error)}
            continue
        theirs = peer.nearest()
        colors = torch.rand(len(peer.triangles) + 1, 3, device=where, requires_grad=True)
        upstream = torch.rand(camera.height * camera.width, 3, device=where)
        records[kind.module] = {
            "visibility_ms": timed(peer.nearest, repeats, device),
            "step_ms": timed(partial(_step, peer, colors, upstream), repeats, device),
            "other": float((theirs != ours)[(ours >= 0) | (theirs >= 0)].float().mean()),
        }
    return records


def _step(peer: GpuPeer, colors: Float32[Tensor, "T1 3"], upstream: Float32[Tensor, "P 3"]) -> None:
    """Paint each pixel in its triangle's colour, the first one where nothing is, and take the gradient."""
    colors.grad = None
    colors.index_select(0, peer.nearest().view(-1) + 1).backward(upstream)
