"""Bodies composited over backgrounds, and the logo into its pixels and back, as numba loops.

View by view, without intermediate arrays. Images' pixels are rows [P, 3] of a canvas; the last takes what leaves them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Int64, Integer
from torch import Tensor

from cloak_core.core.linear import LinearMap, SparseMap
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.compiled import arrays, loop

Shifts = Integer[Tensor, "B 2"]
ZERO, ONE = np.float32(0), np.float32(1)


def draw_bodies(
    views: Sequence[BakedView], rows: Float32[Tensor, "P 3"], shifts: Shifts | None
) -> tuple[Float32[Tensor, "M 3"], Int64[Tensor, " M"]]:
    """See `torch/painting.py`."""
    maps = [view.map for view in views]
    count = sum(each.height for each in maps)
    base, target = torch.empty(count, 3), torch.empty(count, dtype=torch.int64)
    moves = [(0, 0)] * len(views) if shifts is None else shifts.tolist()
    all_rows, all_base, all_target = arrays(rows, base, target)
    for image, (view, own) in enumerate(zip(views, _parts(maps), strict=True)):
        place = (image, view.width, view.height, *moves[image])
        _draw(*view.arrays, *place, all_rows, all_base[own], all_target[own])
    return base, target


def _parts(maps: Sequence[LinearMap]) -> Iterator[slice]:
    """Yield where each view's first pixels stand among those of all."""
    stop = 0
    for each in maps:
        start = stop
        stop = stop + each.height
        yield slice(start, stop)


@dataclass(frozen=True, eq=False)
class LogoMatrix:
    """The maps from colours to the pixels that show them in B images: sparse ones in one loop, others in turn."""

    maps: Sequence[LinearMap]
    own: Sequence[slice]
    """Where each image's pixels stand among those of all."""

    def paint(
        self, colors: Float32[Tensor, "*B L 3"], base: Float32[Tensor, "M 3"], target: Int64[Tensor, " M"], rows: Tensor
    ) -> tuple[Tensor, Tensor]:
        """See `torch/painting.py`."""
        passes = torch.empty(len(target), dtype=torch.uint8)
        all_colors, all_target, all_passes, all_rows = arrays(colors, target, passes, rows)
        for image, (each, own) in enumerate(zip(self.maps, self.own, strict=True)):
            these = colors[image] if colors.ndim == 3 else colors
            body, matrix = base[own], each
            if not isinstance(each, SparseMap):
                body, matrix = body + each.apply(these), SparseMap.empty(each.height)
            these = all_colors[image] if all_colors.ndim == 3 else all_colors
            _paint(*matrix.arrays, these, *arrays(body), all_target[own], all_rows, all_passes[own])
        return passes, target

    def gradient(
        self, kept: tuple[Tensor, Tensor], upstream: Float32[Tensor, "B 3 H W"], shape: Sequence[int]
    ) -> Float32[Tensor, "*B L 3"]:
        """See `torch/painting.py`."""
        images, _, height, width = upstream.shape
        pixel_step = 1
        channel_step = height * width
        if upstream.is_contiguous(memory_format=torch.channels_last):
            upstream = upstream.permute(0, 2, 3, 1)
            pixel_step, channel_step = 3, 1
        result = torch.zeros(shape)
        passes, target, numbers = arrays(*kept, upstream.reshape(images, -1))
        for image, (each, own) in enumerate(zip(self.maps, self.own, strict=True)):
            part = result[image] if result.ndim == 3 else result
            is_sparse = isinstance(each, SparseMap)
            matrix = each if is_sparse else SparseMap.identity(each.height)
            sums = part if is_sparse else torch.zeros(each.height, 3)
            place = (passes[own], target[own], image * height * width, numbers[image], pixel_step, channel_step)
            _add_gradient(*matrix.arrays, *place, sums.numpy())
            if not is_sparse:
                part += each.adjoint(sums)
        return result


def logo_matrix(maps: Sequence[LinearMap]) -> LogoMatrix:
    """See `torch/painting.py`."""
    return LogoMatrix(maps, list(_parts(maps)))


@loop
def _draw(pixels, coverage, base_color, image, width, height, right, down, rows, base, target):
    """Composite one body; the first len(base) pixels, the logo's, without the logo, go into `base`."""
    logo = len(base)
    lost, plane = len(rows) - 1, width * height
    start = stop = moved = 0
    for n in range(len(pixels)):
        pixel = pixels[n]
        cover = coverage[n]
        if pixel < start or pixel >= stop:
            # Rarely: most pixels lie in the same row of the image as the one before. Divisions are slow.
            start = pixel // width * width
            stop, moved = start + width, start + down * width
        x = pixel - start + right
        row = image * plane + moved + x if 0 <= x < width and 0 <= moved < plane else lost
        red, green, blue = base_color[0, n], base_color[1, n], base_color[2, n]
        if cover < ONE:
            beside = ONE - cover
            red, green, blue = red + rows[row, 0] * beside, green + rows[row, 1] * beside, blue + rows[row, 2] * beside
        if n < logo:
            base[n, 0], base[n, 1], base[n, 2], target[n] = red, green, blue, row
        else:
            rows[row, 0], rows[row, 1], rows[row, 2] = _clamped(red), _clamped(green), _clamped(blue)


@loop
def _paint(crow, face, weight, colors, base, target, rows, passes):
    """Draw one image's logo. Bit c of `passes`: channel c passes a gradient, as it is seen and not clamped."""
    lost = len(rows) - 1
    for m in range(len(target)):
        row = target[m]
        red, green, blue = base[m, 0], base[m, 1], base[m, 2]
        for entry in range(crow[m], crow[m + 1]):
            part = weight[entry]
            f = face[entry]
            red += part * colors[f, 0]
            green += part * colors[f, 1]
            blue += part * colors[f, 2]
        shown_red, shown_green, shown_blue = _clamped(red), _clamped(green), _clamped(blue)
        rows[row, 0], rows[row, 1], rows[row, 2] = shown_red, shown_green, shown_blue
        same = (shown_red == red) * 1 | (shown_green == green) * 2 | (shown_blue == blue) * 4
        passes[m] = 0 if row == lost else same


@loop
def _add_gradient(crow, face, weight, passes, target, first, upstream, pixel_step, channel_step, result):
    """Add one image's share. Row `first` is the image's first pixel; `upstream` holds all numbers of the image."""
    for m in range(len(target)):
        passing = passes[m]
        if passing == 0:
            continue
        at = (target[m] - first) * pixel_step
        red = upstream[at] if passing & 1 else ZERO
        green = upstream[at + channel_step] if passing & 2 else ZERO
        blue = upstream[at + 2 * channel_step] if passing & 4 else ZERO
        for entry in range(crow[m], crow[m + 1]):
            part = weight[entry]
            f = face[entry]
            result[f, 0] += part * red
            result[f, 1] += part * green
            result[f, 2] += part * blue


@loop
def _clamped(value):
    """Clamp to [0, 1]; NaN stays NaN."""
    return min(max(value, ZERO), ONE)
