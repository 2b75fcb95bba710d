"""Squares of a cloth under the rectangles that fragments cover on it, in torch."""

from __future__ import annotations

import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from cloak_core.core.cloth import LEAST_SQUARES, MOST_SQUARES, Cloth
from cloak_core.core.linear import SparseMap


def squares_under(cloth: Cloth, middle: Float32[Tensor, "2 E"], extent: Float32[Tensor, "2 E"]) -> SparseMap:
    """See `Backend.squares_under`."""
    low = (middle - extent / 2) / cloth.square
    high = low + (extent / cloth.square).clamp(min=LEAST_SQUARES)
    count = (high.ceil() - low.floor()).clamp(max=MOST_SQUARES).to(torch.int64)
    per_row = count[0] * count[1]
    row = torch.repeat_interleave(per_row)
    crow = torch.cat([per_row.new_zeros(1), per_row.cumsum(0)])
    place = torch.arange(len(row), device=row.device) - crow.index_select(0, row)
    across = count[0].index_select(0, row)
    step_down = torch.div(place, across, rounding_mode="floor")
    column, width = _along(low[0], high[0], count[0], row, place - step_down * across)
    line, height = _along(low[1], high[1], count[1], row, step_down)
    square = line % cloth.rows * cloth.count + column % cloth.count
    return SparseMap(crow, square, width * height, len(cloth))


def _along(
    low: Float[Tensor, " E"],
    high: Float[Tensor, " E"],
    count: Int64[Tensor, " E"],
    row: Int64[Tensor, " N"],
    step: Int64[Tensor, " N"],
) -> tuple[Int64[Tensor, " N"], Float[Tensor, " N"]]:
    """Number of the square at this step along one axis of its rectangle, and its share of the rectangle's side."""
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
