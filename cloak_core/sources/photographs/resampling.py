"""Photographs resampled into images, and the clothes on a person along with them, as numba loops.

The sums of the sparse products in `views`, without their intermediate matrices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int64, UInt8
from scipy import sparse

from cloak_core.core.visibility.compiled import loop

_FEW = 48
"""Columns of a row that are sorted by insertion; more of them by numpy."""


class Dressed(NamedTuple):
    """An image of N pixels; the first M show what is worn."""

    pixels: Int64[np.ndarray, " N"]
    """Flat index y * size + x; ascending among the first M, and among the others."""
    base_color: Float32[np.ndarray, "3 N"]
    crow: Int64[np.ndarray, " M1"]
    column: Int64[np.ndarray, " E"]
    """Colours; ascending within each pixel."""
    weight: Float32[np.ndarray, " E"]


def resample_dressed(
    image: UInt8[np.ndarray, "H W 3"],
    pixels: Int64[np.ndarray, " P"],
    worn: sparse.csr_matrix,
    light: Float[np.ndarray, " P"],
    down: sparse.csr_matrix,
    across: sparse.csr_matrix,
    padding: float,
) -> Dressed:
    """Resample a photograph by kernels down [size, H] and across [size, W], with what its P pixels wear [P, colours].

    light: what colours are multiplied by; padding: the grey beyond the photograph, in [0, 1].
    """
    kernels = [part for kernel in (down, across) for part in (kernel.indptr, kernel.indices, kernel.data)]
    taken = np.asarray(worn.sum(axis=1)).ravel()
    clothes = worn.indptr, worn.indices, worn.data, taken, light, worn.shape[1]
    height, width = image.shape[:2]
    left, order, rank, crow, column, weight = _lay(pixels, *clothes, height, width, *kernels)
    table = np.arange(256, dtype=np.float32) / 255
    beyond = padding * (1 - np.outer(down.sum(axis=1), across.sum(axis=1)))
    base = _resampled(image, left, table, *kernels, beyond, rank)
    return Dressed(order, base, crow, column, weight)


@loop
def _lay(
    pixels,
    crow,
    column,
    weight,
    taken,
    light,
    colors,
    height,
    width,
    y_start,
    y_index,
    y_weight,
    x_start,
    x_index,
    x_weight,
):
    """Map colours to the image's pixels: what the clothes leave of the photograph's, the image's in order, the map."""
    size = len(y_start) - 1
    left = np.ones((height, width), np.float32)
    row = np.full(height * width, -1, np.int32)
    leftmost = np.full(height, width)
    rightmost = np.full(height, -1)
    for p in range(len(pixels)):
        if crow[p + 1] > crow[p]:
            y = pixels[p] // width
            x = pixels[p] - y * width
            left[y, x] = 1 - taken[p]
            row[pixels[p]] = p
            leftmost[y], rightmost[y] = min(leftmost[y], x), max(rightmost[y], x)
    is_worn = np.zeros(size * size, np.bool_)
    starts = np.zeros(size * size + 1, np.int64)
    columns, weights = np.empty(8 * len(column) + colors, np.int64), np.empty(8 * len(column) + colors, np.float32)
    total = np.empty(colors)
    last = np.full(colors, -1)
    met = np.empty(colors, np.int64)
    shown = end = 0
    for y in range(size):
        low, high = width, -1
        for t in range(y_start[y], y_start[y + 1]):
            low, high = min(low, leftmost[y_index[t]]), max(high, rightmost[y_index[t]])
        for x in range(size):
            first, stop = x_start[x], x_start[x + 1]
            if first == stop or x_index[stop - 1] < low or x_index[first] > high:
                continue
            place = y * size + x
            many = 0
            for t in range(y_start[y], y_start[y + 1]):
                for u in range(first, stop):
                    p = row[y_index[t] * width + x_index[u]]
                    if p < 0:
                        continue
                    part = y_weight[t] * x_weight[u]
                    for entry in range(crow[p], crow[p + 1]):
                        c = column[entry]
                        value = part * (light[p] * weight[entry])
                        if last[c] == place:
                            total[c] += value
                        else:
                            last[c], total[c], met[many] = place, value, c
                            many += 1
            if many == 0:
                continue
            _sort(met, many)
            if end + many > len(columns):
                columns = np.concatenate((columns, np.empty(len(columns) + many, np.int64)))
                weights = np.concatenate((weights, np.empty(len(weights) + many, np.float32)))
            begun = end
            for k in range(many):
                if total[met[k]] != 0:
                    columns[end], weights[end] = met[k], total[met[k]]
                    end += 1
            if end > begun:
                is_worn[place] = True
                shown += 1
                starts[shown] = end
    order, rank = np.empty(size * size, np.int64), np.empty(size * size, np.int64)
    worn, bare = 0, shown
    for place in range(size * size):
        if is_worn[place]:
            order[worn], rank[place] = place, worn
            worn += 1
        else:
            order[bare], rank[place] = place, bare
            bare += 1
    return left, order, rank, starts[: shown + 1].copy(), columns[:end].copy(), weights[:end].copy()


@loop
def _sort(values, count):
    """Sort the first `count` values in place."""
    if count > _FEW:
        values[:count] = np.sort(values[:count])
        return
    for k in range(1, count):
        value = values[k]
        at = k
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value


@loop
def _resampled(image, left, table, y_start, y_index, y_weight, x_start, x_index, x_weight, beyond, rank):
    """The photograph beside what is worn: [3, size * size].

    left: what the clothes leave of each of its pixels; beyond: the grey beyond its border; rank: of each pixel
    in the image's order.
    """
    size = len(y_start) - 1
    base = np.empty((3, size * size), np.float32)
    line = np.zeros((image.shape[1], 3))
    low, high = image.shape[1], -1
    for u in range(len(x_index)):
        low, high = min(low, x_index[u]), max(high, x_index[u])
    for y in range(size):
        line[low : high + 1] = 0
        for t in range(y_start[y], y_start[y + 1]):
            part, source = y_weight[t], y_index[t]
            for x in range(low, high + 1):
                for channel in range(3):
                    line[x, channel] += part * (table[image[source, x, channel]] * left[source, x])
        for x in range(size):
            red = green = blue = 0.0
            for u in range(x_start[x], x_start[x + 1]):
                part, source = x_weight[u], x_index[u]
                red += part * line[source, 0]
                green += part * line[source, 1]
                blue += part * line[source, 2]
            at, grey = rank[y * size + x], beyond[y, x]
            base[0, at], base[1, at], base[2, at] = red + grey, green + grey, blue + grey
    return base
