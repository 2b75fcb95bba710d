"""What a peer renderer has to do: say which triangle is seen at every sample. Our own shading does the rest.

So all peers are compared by the same figures, and a difference in an image is a difference in visibility.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float32, Int32, Int64

from cloak_core.render.types import Window
from cloak_core.scene.cameras import Camera, Vector


@dataclass(frozen=True)
class Target:
    """What to look at: the samples, n x n to a pixel, of a window of a camera's image."""

    camera: Camera
    pivot: Vector
    n: int
    window: Window
    cull: bool
    """Whether triangles that show their back may be dropped: the body is closed, nothing cuts it open."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of samples."""
        return (self.window.y1 - self.window.y0) * self.n, (self.window.x1 - self.window.x0) * self.n

    def rays(self) -> tuple[Float32[np.ndarray, "N 3"], Float32[np.ndarray, "N 3"]]:
        """Origins on the near plane and directions (of length 1 along the optical axis) through all samples."""
        rows, columns = self.shape
        x = (self.window.x0 + (np.arange(columns) + 0.5) / self.n - self.camera.width / 2) / self.camera.focal
        y = (self.camera.height / 2 - self.window.y0 - (np.arange(rows) + 0.5) / self.n) / self.camera.focal
        directions = np.empty((rows, columns, 3), np.float32)
        for axis, (right, up, back) in enumerate(zip(*self.camera.axes, strict=True)):
            directions[..., axis] = np.add.outer((y * up - back).astype(np.float32), (x * right).astype(np.float32))
        origins = directions * np.float32(self.camera.near_plane)
        origins += np.array(self.camera.position(self.pivot), np.float32)
        return origins.reshape(-1, 3), directions.reshape(-1, 3)


class Peer(ABC):
    """A renderer of one topology. Making one raises `ImportError` where its package or a library of it is missing."""

    module: ClassVar[str]
    """What is imported; also the peer's name in reports."""

    @abstractmethod
    def __init__(self, triangles: Int64[np.ndarray, "T 3"], threads: int) -> None: ...

    @abstractmethod
    def pose(self, vertices: Float32[np.ndarray, "V 3"]) -> None:
        """Take a pose and do all that is done once for it, such as building a tree."""

    @abstractmethod
    def aim(self, target: Target) -> None:
        """Take a view and do what can be done before the pose is looked at, such as making rays."""

    @abstractmethod
    def look(self) -> Int32[np.ndarray, "rows columns"]:
        """Find the triangle at every sample of the target, -1 = none."""
