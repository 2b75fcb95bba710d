"""Photographs resampled into images, and what is laid onto a person along with them.

Both kernels are separable: columns first, then rows. The numba loops and the torch operations give the same sums.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64, UInt8
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
        # Made smaller, a pixel averages all that it covers (else it would alias); made larger, it interpolates.
        reach = max(scale, 1.0) * softness
        centre = start + (np.arange(size) + 0.5) * scale - 0.5
        if mirror:
            centre = centre[::-1]
        taps = int(np.ceil(2 * reach)) + 1
        column = np.floor(centre - reach).astype(int)[:, None] + 1 + np.arange(taps)
        weight = np.maximum(1 - np.abs(column - centre[:, None]) / reach, 0)
        return Kernel._within(column, weight / weight.sum(axis=1, keepdims=True), count)

    @staticmethod
    def _within(column: Int64[np.ndarray, "n k"], weight: Float[np.ndarray, "n k"], count: int) -> Kernel:
        """Drop neighbours that are not within 0 .. count - 1: rows begin where there are some instead.

        So the loops need no test of bounds. What is dropped is not made up for: at the border of the photograph a pixel
        shows that share of the padding.
        """
        taps = column.shape[1]
        first = np.clip(column[:, 0], 0, max(count - taps, 0))
        moved = np.zeros((len(column), min(taps, count)), np.float32)
        at = column - first[:, None]
        row, tap = np.nonzero((at >= 0) & (at < moved.shape[1]) & (column >= 0) & (column < count))
        moved[row, at[row, tap]] = weight[row, tap]
        return Kernel(first, moved, count)

    @property
    def sums(self) -> Float32[np.ndarray, " n"]:
        """How much of each pixel lies in the photograph."""
        return self.weight.sum(axis=1)

    def reached(self, low: int, high: int) -> slice:
        """Find the pixels of the image that see any of the photograph's from `low` to `high` - 1."""
        seen = (self.first < high) & (self.first + self.weight.shape[1] > low)
        at = np.flatnonzero(seen)
        return slice(int(at[0]), int(at[-1]) + 1) if len(at) else slice(0, 0)

    def part(self, rows: slice, low: int, high: int) -> Kernel:
        """Take the kernel of some of the image's pixels, for the photograph's from `low` to `high` - 1."""
        column = self.first[rows, None] + np.arange(self.weight.shape[1])
        return Kernel._within(column - low, self.weight[rows], high - low)

    @cached_property
    def dense(self) -> Float32[Tensor, "n count"]:
        """The same as a matrix, for devices on which products are cheaper than gathers."""
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
        flat = picture.reshape(len(picture), -1).contiguous().numpy()
        _resample(flat, down.first, down.weight, across.first, across.weight, result)
        return torch.from_numpy(result)
    down, across = (kernel.dense.to(picture.device) for kernel in (down, across))
    return torch.einsum("yh,hwc,xw->yxc", down, picture, across).contiguous()


def spread_back(upstream: Float32[Tensor, "h w 3"], down: Kernel, across: Kernel) -> Float32[Tensor, "H W 3"]:
    """The transpose of `resample`: bring a gradient of its result back to the picture."""
    if not len(down.first) or not len(across.first):
        return upstream.new_zeros(down.count, across.count, 3)
    if use_loops(upstream.device):
        result = np.zeros((down.count, across.count * 3), np.float32)
        _spread(upstream.contiguous().numpy(), down.first, down.weight, across.first, across.weight, result)
        return torch.from_numpy(result).view(down.count, across.count, 3)
    down, across = (kernel.dense.to(upstream.device) for kernel in (down, across))
    return torch.einsum("yh,yxc,xw->hwc", down, upstream, across).contiguous()


def photograph(
    image: UInt8[np.ndarray, "H W 3"],
    left: Float32[Tensor, "H W"],
    down: Kernel,
    across: Kernel,
    padding: float,
    pixels: Int64[Tensor, " R"],
) -> Float32[Tensor, "3 R"]:
    """Resample what is left of a photograph, [0, 1]; grey of `padding` beyond its border.

    pixels: in which order the image's are given.
    """
    if use_loops(left.device):
        dimmed = torch.empty(image.shape[0], 3 * image.shape[1])
        _dimmed(image, left.numpy(), dimmed.numpy())
        picture = dimmed.view(*image.shape)
    else:
        picture = torch.from_numpy(image).to(left.device).float().mul_(left.div(255).unsqueeze(2))
    shown = resample(picture, down, across)
    inside = torch.outer(torch.from_numpy(down.sums), torch.from_numpy(across.sums))
    if inside.min() < 1 - 1e-6:
        shown.add_((padding * (1 - inside)).to(left.device).unsqueeze(2))
    shown = shown.view(-1, 3)
    if not use_loops(left.device):
        return shown.index_select(0, pixels).T.contiguous()
    ordered = torch.empty(3, len(pixels))
    _gather(shown.numpy(), pixels.numpy(), ordered.numpy())
    return ordered


@dataclass(frozen=True, eq=False)
class Resampling:
    """A `LinearMap` from the P pixels of a person in a photograph to a rectangle of the image."""

    pixels: Int64[Tensor, " P"]
    """Flat in the part of the photograph that the kernels see."""
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


_TOGETHER = 8
"""Rows of the image that are made together: as many as a vector register has lanes."""


@loop
def _resample(picture, y_first, y_weight, x_first, x_weight, result):
    """picture: [H, W * 3]; result: [h, w, 3]. Down first, then across, some rows of the image at once.

    Rows of the picture lie side by side in memory, so the filter down adds whole rows. Before the one across, the rows
    of `_TOGETHER` pixels of the image are laid beside each other: its taps, which differ from pixel to pixel, are then
    the same for one vector register.
    """
    low, high = 3 * x_first.min(), 3 * (x_first.max() + x_weight.shape[1])
    line = np.empty(picture.shape[1], np.float32)
    lines = np.zeros((picture.shape[1], _TOGETHER), np.float32)
    total = np.empty((3, _TOGETHER), np.float32)
    for start in range(0, len(y_first), _TOGETHER):
        count = min(_TOGETHER, len(y_first) - start)
        for k in range(count):
            line[low:high] = 0
            for tap in range(y_weight.shape[1]):
                part = y_weight[start + k, tap]
                if part != 0:
                    source = picture[y_first[start + k] + tap]
                    for at in range(low, high):
                        line[at] += part * source[at]
            for at in range(low, high):
                lines[at, k] = line[at]
        for x in range(len(x_first)):
            total[:] = 0
            for tap in range(x_weight.shape[1]):
                part, first = x_weight[x, tap], 3 * (x_first[x] + tap)
                for channel in range(3):
                    for k in range(_TOGETHER):
                        total[channel, k] += part * lines[first + channel, k]
            for k in range(count):
                for channel in range(3):
                    result[start + k, x, channel] = total[channel, k]


@loop
def _spread(upstream, y_first, y_weight, x_first, x_weight, result):
    """upstream: [h, w, 3]; result: [H, W * 3], zeros. The transpose of `_resample`: across first, then down."""
    low, high = 3 * x_first.min(), 3 * (x_first.max() + x_weight.shape[1])
    lines = np.empty((result.shape[1], _TOGETHER), np.float32)
    gradient = np.zeros((3, _TOGETHER), np.float32)
    for start in range(0, len(y_first), _TOGETHER):
        count = min(_TOGETHER, len(y_first) - start)
        lines[low:high] = 0
        for x in range(len(x_first)):
            for k in range(count):
                for channel in range(3):
                    gradient[channel, k] = upstream[start + k, x, channel]
            for tap in range(x_weight.shape[1]):
                part, first = x_weight[x, tap], 3 * (x_first[x] + tap)
                for channel in range(3):
                    for k in range(_TOGETHER):
                        lines[first + channel, k] += part * gradient[channel, k]
        for k in range(count):
            for tap in range(y_weight.shape[1]):
                part = y_weight[start + k, tap]
                if part != 0:
                    target = result[y_first[start + k] + tap]
                    for at in range(low, high):
                        target[at] += part * lines[at, k]


@loop
def _gather(image, pixels, ordered):
    for n in range(len(pixels)):
        for channel in range(3):
            ordered[channel, n] = image[pixels[n], channel]


@loop
def _dimmed(image, left, result):
    """What is left of each pixel of a photograph, in [0, 1]."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            part = left[y, x] / np.float32(255)
            for channel in range(3):
                result[y, 3 * x + channel] = np.float32(image[y, x, channel]) * part
