"""Squares of a cloth under the rectangles that fragments cover on it, as numba loops."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.core.cloth import LEAST_SQUARES, MOST_SQUARES, Cloth
from cloak_core.core.linear import SparseMap
from cloak_core.core.visibility.compiled import arrays, loop

_ONE = np.float32(1)
_HALF = np.float32(0.5)


def squares_under(cloth: Cloth, middle: Float32[Tensor, "2 E"], extent: Float32[Tensor, "2 E"]) -> SparseMap:
    """See `Backend.squares_under`."""
    low = (middle - extent / 2) / cloth.square
    high = low + (extent / cloth.square).clamp(min=LEAST_SQUARES)
    made = _squares(*arrays(low, high), cloth.count, cloth.rows, MOST_SQUARES)
    return SparseMap(*map(torch.from_numpy, made), len(cloth))


@loop
def _squares(low, high, columns, lines, most):
    """Row offsets, squares and shares; first every rectangle's squares are counted, then written."""
    crow = np.zeros(low.shape[1] + 1, np.int64)
    for e in range(low.shape[1]):
        crow[e + 1] = crow[e] + _count(low[0, e], high[0, e], most) * _count(low[1, e], high[1, e], most)
    square, part = np.empty(crow[-1], np.int64), np.empty(crow[-1], np.float32)
    at = 0
    for e in range(low.shape[1]):
        across, down = _count(low[0, e], high[0, e], most), _count(low[1, e], high[1, e], most)
        for y in range(down):
            line, height = _along(low[1, e], high[1, e], down, y, most)
            first = line % lines * columns
            for x in range(across):
                column, width = _along(low[0, e], high[0, e], across, x, most)
                square[at], part[at] = first + column % columns, width * height
                at += 1
    return crow, square, part


@loop
def _count(low, high, most):
    return min(int(math.ceil(high) - math.floor(low)), most)


@loop
def _along(low, high, count, step, most):
    """Number of the square at this step along one axis of its rectangle, and its share of the rectangle's side."""
    start = np.float32(math.floor(low))
    if high - start > most:  # too wide to visit every square: evenly spaced ones
        spaced = low + (np.float32(step) + _HALF) * (high - low) / np.float32(count)
        return math.floor(spaced), _ONE / np.float32(count)
    square = start + np.float32(step)
    covered = min(high, square + _ONE) - max(low, square)
    return int(square), max(covered, np.float32(0)) / (high - low)
