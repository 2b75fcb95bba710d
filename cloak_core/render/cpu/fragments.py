"""Samples to fragments, as numba loops."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from cloak_core.render.compiled import arrays, loop
from cloak_core.render.packing import EMPTY, ID_BITS
from cloak_core.render.types import Fragments, Window

_ID = (1 << ID_BITS) - 1


def merge_samples(packed: Tensor, grid: int, window: Window, width: int) -> Fragments:
    """See `Backend.merge_samples`."""
    found = _merge(*arrays(packed), grid, window.y0 * grid, window.x0 * grid, width)
    return Fragments(*map(torch.from_numpy, found))


@loop
def _merge(packed, grid, row0, column0, width):
    """Merge each pixel's visible samples by triangle, ascending: pixel, triangle, area, mean x and y.

    packed: [rows, columns], grid x grid samples to a pixel, from the sample at row0 and column0 of the image on.
    """
    most = count = 0
    for key in packed.flat:
        most += key != EMPTY
    pixel, triangle, area = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.float32)
    x, y = np.empty(most), np.empty(most)
    names, sums = np.empty(grid * grid, np.int64), np.empty((3, grid * grid), np.int64)
    for top in range(0, packed.shape[0], grid):
        for left in range(0, packed.shape[1], grid):
            found = _gather(packed, top, left, grid, names, sums)
            place = (row0 + top) // grid * width + (column0 + left) // grid
            for i in range(found):
                held = sums[0, i]
                x[count] = (column0 + left + 0.5 + sums[1, i] / held) / grid
                y[count] = (row0 + top + 0.5 + sums[2, i] / held) / grid
                area[count] = held / (grid * grid)
                pixel[count], triangle[count] = place, names[i]
                count += 1
    return pixel[:count], triangle[:count], area[:count], x[:count], y[:count]


@loop
def _gather(packed, top, left, grid, names, sums):
    """List a pixel's triangles, ascending, with the number and the sums of columns and rows of their samples."""
    found = 0
    for row in range(grid):
        for column in range(grid):
            key = packed[top + row, left + column]
            if key == EMPTY:
                continue
            at = found - 1  # the latest is the likeliest
            while at >= 0 and names[at] != key & _ID:
                at -= 1
            if at < 0:
                at = found
                while at > 0 and names[at - 1] > key & _ID:
                    names[at], sums[0, at] = names[at - 1], sums[0, at - 1]
                    sums[1, at], sums[2, at] = sums[1, at - 1], sums[2, at - 1]
                    at -= 1
                names[at] = key & _ID
                sums[0, at] = sums[1, at] = sums[2, at] = 0
                found += 1
            sums[0, at] += 1
            sums[1, at] += column
            sums[2, at] += row
    return found
