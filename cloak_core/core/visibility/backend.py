"""The stages of rendering as one typed protocol, and the choice of its implementation by device.

Each stage has a numba and a torch implementation, in files of equal names: cpu/ for the CPU, torch/ for any device.
Two have a Triton kernel, too, in fused/, for CUDA; CLOAK_TRITON=0 switches them off.
Both give the same face ids, bit for bit, and the same weights within 1e-6; tests compare them (`compiled.torch_alone`).
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Protocol, cast, runtime_checkable

import torch
from jaxtyping import Float32, Int64, Integer, UInt8
from torch import Tensor

from cloak_core.core.cameras import Vector
from cloak_core.core.linear import LinearMap, SparseMap
from cloak_core.core.view import BakedView, FlatTriangles, Fragments, Screen, Surface, View, Window
from cloak_core.core.visibility.compiled import use_kernels, use_loops


@runtime_checkable
class LogoMatrix(Protocol):
    """The maps from colours to the pixels that show them in B images."""

    def paint(
        self, colors: Float32[Tensor, "*B L 3"], base: Float32[Tensor, "M 3"], target: Int64[Tensor, " M"], rows: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Write base + matrix @ colors into the rows `target` of a canvas. Returns what `gradient` needs of it."""

    def gradient(
        self, kept: tuple[Tensor, Tensor], upstream: Float32[Tensor, "B 3 H W"], shape: Sequence[int]
    ) -> Float32[Tensor, "*B L 3"]:
        """Compute the gradient of colours of this shape, from that of the images."""


@runtime_checkable
class Backend(Protocol):
    """The stages after projection, in the order of a render."""

    def cover(
        self, packed: Int64[Tensor, "rows columns"], flat: FlatTriangles, row0: int, column0: int, shift: int
    ) -> None:
        """Lower packed depth and id to the nearest triangle's, at the samples from row0 and column0 on.

        shift: there are 2^shift grid units between samples.
        """

    def visible_areas(self, flat: FlatTriangles, window: Window, width: int) -> Iterable[Fragments]:
        """Find each triangle's exact visible share in each pixel of a window of an image `width` pixels wide.

        In parts from top to bottom. Warns of `CrowdedPixels`.
        """

    def merge_samples(self, packed: Tensor, grid: int, window: Window, width: int) -> Fragments:
        """Merge the visible samples of every (pixel, triangle) of one view; packed: [rows, columns]."""

    def build_view(
        self,
        fragments: Fragments,
        screen: Screen,
        surface: Surface,
        normals: Float32[Tensor, "3 V"],
        light_position: Float32[Tensor, " 3"],
    ) -> View:
        """Light the fragments of one view, or a band of it, and sum them up to its matrix.

        normals (of the vertices) and light position are in view space.
        """

    def split(
        self,
        view: View,
        logo: Int64[Tensor, " L"],
        colors: Float32[Tensor, "F 3"],
        light_color: Vector,
        texture: UInt8[Tensor, "h w 3"] | None,
    ) -> tuple[Tensor, Tensor, Tensor, int, SparseMap]:
        """Split a view into the logo's map and the base colours.

        Returns pixels, coverage, base_color, front_count and map of a `BakedView`.
        """

    def draw_bodies(
        self,
        views: Sequence[BakedView],
        rows: Float32[Tensor, "P 3"],
        shifts: Integer[Tensor, "B 2"] | None,
    ) -> tuple[Float32[Tensor, "M 3"], Int64[Tensor, " M"]]:
        """Composite B bodies, except the M logo pixels, over the rows of a canvas.

        Returns what the logo's pixels show beside the logo, and their rows: the last row for pixels outside the image.
        """

    def logo_matrix(self, maps: Sequence[LinearMap]) -> LogoMatrix:
        """Put together the maps of B images, each from colours to the pixels that show them."""


def backend(device: torch.device) -> Backend:
    """Choose the implementation for a device: numba on the CPU where there is numba, else torch or Triton."""
    if use_loops(device):
        return _loaded("cpu")
    return _loaded("fused" if use_kernels(device) else "torch")


@cache
def _loaded(name: str) -> Backend:
    # By name, as each device needs one of them.
    return cast(Backend, importlib.import_module(f"{__package__}.{name}"))
