"""The one sampler of a cloth: the mean of the squares under the part of the cloth that is seen at once at a place."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor

from cloak_core.core.linear import SparseMap
from cloak_core.core.visibility.compiled import arrays, loop, use_loops

MOST_SQUARES = 8
"""Squares along each side of a footprint that are averaged; of more, as many evenly spaced ones are."""
LEAST_SQUARES = 1e-3
"""Least width of a footprint, squares: below it, rounding decides."""
_ONE = np.float32(1)
_HALF = np.float32(0.5)


def squares_under(
    at: Float32[Tensor, "2 P"],
    extent: Float32[Tensor, "2 P"],
    is_worn: Bool[Tensor, " P"],
    square: float,
    rows: int,
    columns: int,
) -> SparseMap:
    """Find the squares under footprints and their shares: places x squares, rows add up to 1 or are empty.

    at: middles, metres right and down on the cloth; extent: width and height, metres. is_worn: places that show the
    cloth at all. square: width and height of a square, metres; the cloth of `rows` x `columns` squares repeats.
    """
    low = (at - extent / 2) / square
    high = low + (extent / square).clamp(min=LEAST_SQUARES)
    if use_loops(at.device):
        made = _squares(*arrays(low, high, is_worn), columns, rows, MOST_SQUARES)
        return SparseMap(*map(torch.from_numpy, made), rows * columns, is_whole=True)
    count = (high.ceil() - low.floor()).clamp(max=MOST_SQUARES).to(torch.int64) * is_worn
    per_row = count[0] * count[1]
    row = torch.repeat_interleave(per_row)
    crow = torch.cat([per_row.new_zeros(1), per_row.cumsum(0)])
    place = torch.arange(len(row), device=row.device) - crow.index_select(0, row)
    across = count[0].index_select(0, row)
    step_down = torch.div(place, across, rounding_mode="floor")
    column, width = _steps(low[0], high[0], count[0], row, place - step_down * across)
    line, height = _steps(low[1], high[1], count[1], row, step_down)
    return SparseMap(crow, line % rows * columns + column % columns, width * height, rows * columns, is_whole=True)


def _steps(
    low: Float[Tensor, " P"],
    high: Float[Tensor, " P"],
    count: Int64[Tensor, " P"],
    row: Int64[Tensor, " N"],
    step: Int64[Tensor, " N"],
) -> tuple[Int64[Tensor, " N"], Float[Tensor, " N"]]:
    """Number of the square at this step along one axis of its footprint, and its share of the footprint's side."""
    start = low.index_select(0, row)
    end = high.index_select(0, row)
    steps = count.index_select(0, row)
    square = start.floor() + step
    part = (torch.minimum(end, square + 1) - torch.maximum(start, square)).clamp(min=0) / (end - start)
    # Too wide to visit every square: evenly spaced ones.
    spaced = (start + (step + 0.5) * (end - start) / steps).floor()
    is_wide = end - start.floor() > MOST_SQUARES
    square = torch.where(is_wide, spaced, square)
    return square.to(torch.int64), torch.where(is_wide, 1 / steps, part)


@loop
def _squares(low, high, is_worn, columns, lines, most):
    """Row offsets, squares and shares; first every footprint's squares are counted, then written."""
    crow = np.zeros(low.shape[1] + 1, np.int64)
    for p in range(low.shape[1]):
        crow[p + 1] = crow[p]
        if is_worn[p]:
            crow[p + 1] += _count(low[0, p], high[0, p], most) * _count(low[1, p], high[1, p], most)
    square, part = np.empty(crow[-1], np.int64), np.empty(crow[-1], np.float32)
    column, width = np.empty(most, np.int64), np.empty(most, np.float32)
    at = 0
    for p in range(low.shape[1]):
        if not is_worn[p]:
            continue
        across, down = _count(low[0, p], high[0, p], most), _count(low[1, p], high[1, p], most)
        for x in range(across):
            number, width[x] = _along(low[0, p], high[0, p], across, x, most)
            column[x] = number % columns
        for y in range(down):
            line, height = _along(low[1, p], high[1, p], down, y, most)
            first = line % lines * columns
            for x in range(across):
                square[at], part[at] = first + column[x], width[x] * height
                at += 1
    return crow, square, part


@loop
def _count(low, high, most):
    return min(int(math.ceil(high) - math.floor(low)), most)


@loop
def _along(low, high, count, step, most):
    """`_steps` at one place."""
    start = np.float32(math.floor(low))
    if high - start > most:
        spaced = low + (np.float32(step) + _HALF) * (high - low) / np.float32(count)
        return math.floor(spaced), _ONE / np.float32(count)
    square = start + np.float32(step)
    covered = min(high, square + _ONE) - max(low, square)
    return int(square), max(covered, np.float32(0)) / (high - low)
