"""Photographs resampled into images, and what is laid onto a person along with them.

Both kernels are separable: columns first, then rows. The numba loops and the torch operations give the same sums.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from cloak_core.core.linear import Chain, SparseMap
from cloak_core.core.visibility.compiled import loop, use_loops


@dataclass(frozen=True, eq=False)
class Kernel:
    """A filter along one axis: each of n pixels of the image is a weighted sum of up to k neighbours in the photograph.

    Weights of neighbours beyond the photograph are 0, so that sums are 1 inside it and less at its border.
    """

    first: Int64[np.ndarray, " n"]
    """The first neighbour."""
    weight: Float32[np.ndarray, "n k"]
    count: int
    """Pixels of the photograph along this axis."""

    @staticmethod
    def of(start: float, side: float, size: int, count: int, softness: float = 1.0, mirror: bool = False) -> Kernel:
        """Make a triangle filter: `size` pixels from `start` over `side` of `count` pixels, wider by `softness`."""
        scale = side / size
        reach = max(scale, 1.0) * softness
        centre = start + (np.arange(size) + 0.5) * scale - 0.5
        if mirror:
            centre = centre[::-1]
        taps = int(np.ceil(2 * reach)) + 1
        first = np.floor(centre - reach).astype(int) + 1
        column = first[:, None] + np.arange(taps)
        weight = np.maximum(1 - np.abs(column - centre[:, None]) / reach, 0)
        weight /= weight.sum(axis=1, keepdims=True)
        weight[(column < 0) | (column >= count)] = 0
        # Neighbours that do not exist weigh nothing: move them to where there are some.
        moved = np.clip(first, 0, max(count - taps, 0))
        shifted = np.zeros((size, min(taps, count)))
        for tap in range(taps):
            at = column[:, tap] - moved
            inside = (at >= 0) & (at < shifted.shape[1])
            shifted[np.flatnonzero(inside), at[inside]] += weight[inside, tap]
        return Kernel(moved, shifted.astype(np.float32), count)

    @property
    def sums(self) -> Float32[np.ndarray, " n"]:
        """How much of each pixel lies in the photograph."""
        return self.weight.sum(axis=1)

    def reached(self, low: int, high: int) -> slice:
        """Find the pixels of the image that see any of the photograph's from `low` to `high` - 1."""
        seen = (self.first < high) & (self.first + self.weight.shape[1] > low)
        at = np.flatnonzero(seen)
        return slice(int(at[0]), int(at[-1]) + 1) if len(at) else slice(0, 0)

    def part(self, rows: slice) -> Kernel:
        """Take the kernel of some of the image's pixels."""
        return Kernel(self.first[rows], self.weight[rows], self.count)

    @cached_property
    def dense(self) -> Float32[Tensor, "n count"]:
        """The same as a matrix."""
        matrix = np.zeros((len(self.first), self.count), np.float32)
        rows = np.arange(len(self.first))[:, None]
        np.add.at(matrix, (rows, self.first[:, None] + np.arange(self.weight.shape[1])), self.weight)
        return torch.from_numpy(matrix)


def resample(picture: Float32[Tensor, "H W 3"], down: Kernel, across: Kernel) -> Float32[Tensor, "h w 3"]:
    """Filter a picture along both axes."""
    if not len(down.first) or not len(across.first):
        return picture.new_zeros(len(down.first), len(across.first), 3)
    if use_loops(picture.device):
        result = np.empty((len(down.first), len(across.first), 3), np.float32)
        _resample(picture.contiguous().numpy(), down.first, down.weight, across.first, across.weight, result)
        return torch.from_numpy(result)
    down, across = (kernel.dense.to(picture.device) for kernel in (down, across))
    return torch.einsum("yh,hwc,xw->yxc", down, picture, across)


def spread_back(upstream: Float32[Tensor, "h w 3"], down: Kernel, across: Kernel) -> Float32[Tensor, "H W 3"]:
    """The transpose of `resample`: bring a gradient of its result back to the picture."""
    if not len(down.first) or not len(across.first):
        return upstream.new_zeros(down.count, across.count, 3)
    if use_loops(upstream.device):
        result = np.zeros((down.count, across.count, 3), np.float32)
        _spread(upstream.contiguous().numpy(), down.first, down.weight, across.first, across.weight, result)
        return torch.from_numpy(result)
    down, across = (kernel.dense.to(upstream.device) for kernel in (down, across))
    return torch.einsum("yh,yxc,xw->hwc", down, upstream, across)


@dataclass(frozen=True, eq=False)
class Resampling:
    """A `LinearMap` from the P pixels of a person in a photograph to a rectangle of the image."""

    pixels: Int64[Tensor, " P"]
    """Flat in the photograph."""
    light: Float32[Tensor, " P"]
    """What colours on each are multiplied by."""
    down: Kernel
    """Of the rectangle's rows."""
    across: Kernel
    """Of its columns."""

    @property
    def height(self) -> int:
        """Number of pixels of the rectangle, row by row."""
        return len(self.down.first) * len(self.across.first)

    @property
    def width(self) -> int:
        """P."""
        return len(self.pixels)

    def apply(self, values: Float[Tensor, "P 3"]) -> Float[Tensor, "R 3"]:
        """See `LinearMap`."""
        picture = values.new_zeros(self.down.count * self.across.count, 3)
        picture[self.pixels] = values * self.light.unsqueeze(1)
        return resample(picture.view(self.down.count, -1, 3), self.down, self.across).reshape(-1, 3)

    def adjoint(self, upstream: Float[Tensor, "R 3"]) -> Float[Tensor, "P 3"]:
        """See `LinearMap`."""
        picture = spread_back(upstream.reshape(len(self.down.first), len(self.across.first), 3), self.down, self.across)
        return picture.view(-1, 3).index_select(0, self.pixels) * self.light.unsqueeze(1)

    def __matmul__(self, other: SparseMap) -> Chain | SparseMap:
        """See `LinearMap`: a view of a photograph is used once, so nothing is multiplied out."""
        return Chain(self, other) if len(other) else SparseMap.empty(self.height, other.width, self.light.device)

    def to(self, device: torch.device | str) -> Resampling:
        """Copy the map to a device."""
        return Resampling(self.pixels.to(device), self.light.to(device), self.down, self.across)


@loop
def _resample(picture, y_first, y_weight, x_first, x_weight, result):
    width = picture.shape[1]
    low, high = x_first.min(), x_first.max() + x_weight.shape[1]
    line = np.empty((width, 3), np.float32)
    for y in range(len(y_first)):
        line[low:high] = 0
        for tap in range(y_weight.shape[1]):
            part = y_weight[y, tap]
            if part == 0:
                continue
            source = picture[y_first[y] + tap]
            for x in range(low, high):
                for channel in range(3):
                    line[x, channel] += part * source[x, channel]
        for x in range(len(x_first)):
            first = x_first[x]
            red = green = blue = np.float32(0)
            for tap in range(x_weight.shape[1]):
                part = x_weight[x, tap]
                red += part * line[first + tap, 0]
                green += part * line[first + tap, 1]
                blue += part * line[first + tap, 2]
            result[y, x, 0], result[y, x, 1], result[y, x, 2] = red, green, blue


@loop
def _spread(upstream, y_first, y_weight, x_first, x_weight, result):
    low, high = x_first.min(), x_first.max() + x_weight.shape[1]
    line = np.empty((result.shape[1], 3), np.float32)
    for y in range(len(y_first)):
        line[low:high] = 0
        for x in range(len(x_first)):
            red, green, blue = upstream[y, x, 0], upstream[y, x, 1], upstream[y, x, 2]
            first = x_first[x]
            for tap in range(x_weight.shape[1]):
                part = x_weight[x, tap]
                line[first + tap, 0] += part * red
                line[first + tap, 1] += part * green
                line[first + tap, 2] += part * blue
        for tap in range(y_weight.shape[1]):
            part = y_weight[y, tap]
            if part == 0:
                continue
            target = result[y_first[y] + tap]
            for x in range(low, high):
                for channel in range(3):
                    target[x, channel] += part * line[x, channel]
