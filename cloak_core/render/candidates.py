"""Triangles on the snapped screen, and which of them may cover a sample of a grid at all.

Most triangles of a body are smaller than a pixel: first those go whose bounding box holds no sample, then back faces
and those without area. It takes a few int32 operations for each triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float64, Int32, Int64
from torch import Tensor

from cloak_core.render.projection import GRID

EXACT_EXTENT = 1 << 25
"""Snapped extent below which edge functions are exact in float64: products stay below 2^50."""
_SURE = 512.0
"""A doubled area worked out in float64 from differences below 2^30 is off by less than this."""


@dataclass(frozen=True)
class Window:
    """A part of the image, in pixels: columns x0 <= x < x1, rows y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int


@dataclass(frozen=True)
class Soup:
    """N snapped triangles, corner by corner."""

    x: Int32[Tensor, "3 N"]
    y: Int32[Tensor, "3 N"]
    corner: Int64[Tensor, "3 N"]
    """Where each corner's nearness stands in `nearness`."""
    nearness: Float64[Tensor, " K"]


class SampleGrid:
    """The samples of a window, n x n to a pixel: their rows and columns, counted from the image's top left corner."""

    def __init__(self, window: Window, n: int) -> None:
        self.row0, self.column0 = window.y0 * n, window.x0 * n
        self.rows, self.columns = (window.y1 - window.y0) * n, (window.x1 - window.x0) * n
        self.step = GRID // n
        self.half = self.step // 2
        self.shift = self.step.bit_length() - 1

    def box(self, x: Int32[Tensor, "3 N"], y: Int32[Tensor, "3 N"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """First and last column, first and last row of the samples in triangles' bounding boxes, int32."""
        return *self._span(x, self.column0, self.columns), *self._span(y, self.row0, self.rows)

    def first(self, box: tuple[Tensor, ...], view: Int64[Tensor, " N"] | None) -> Int64[Tensor, " N"]:
        """Flat index of boxes' first samples, all views one after the other."""
        c0, _, r0, _ = box
        first = (r0 - self.row0).to(torch.int64).mul_(self.columns).add_(c0 - self.column0)
        return first if view is None else first.add_(view * (self.rows * self.columns))

    def _span(self, position: Int32[Tensor, "3 N"], first: int, count: int) -> tuple[Tensor, Tensor]:
        a, b, c = position.unbind(0)
        low, high = torch.minimum(a, b), torch.maximum(a, b)
        torch.minimum(low, c, out=low)
        torch.maximum(high, c, out=high)
        low.add_(self.half - 1).bitwise_right_shift_(self.shift)  # ceil((low - half) / step)
        high.sub_(self.half).bitwise_right_shift_(self.shift)
        return low.clamp_(min=first), high.clamp_(max=first + count - 1)


class PixelGrid(SampleGrid):
    """The pixels themselves as the grid: a triangle's box holds every pixel that it touches."""

    def __init__(self, window: Window) -> None:
        super().__init__(window, 1)

    def _span(self, position: Int32[Tensor, "3 N"], first: int, count: int) -> tuple[Tensor, Tensor]:
        low, high = position.amin(0) >> self.shift, (position.amax(0) - 1) >> self.shift
        return low.clamp_(min=first), high.clamp_(max=first + count - 1)


@dataclass(frozen=True)
class Candidates:
    """M of a soup's N triangles that may cover a sample, each with the samples in its box."""

    index: Int64[Tensor, " M"]
    box: tuple[Tensor, Tensor, Tensor, Tensor]
    """First and last column, first and last row, int32 [M]."""
    clockwise: Bool[Tensor, " M"]
    """On a screen with y down."""


def find_candidates(
    samples: SampleGrid, soup: Soup, cull: Bool[Tensor, " N"] | bool, skip: Bool[Tensor, " N"] | None, small: bool
) -> list[tuple[Candidates, torch.dtype]]:
    """Triangles with area and a sample in their box; with the type in which their edge functions do not round.

    cull: where back faces (clockwise) are dropped. skip: triangles to leave out. small: none exceeds `EXACT_EXTENT`.
    """
    c0, c1, r0, r1 = box = samples.box(soup.x, soup.y)
    area = _doubled_area(soup.x.unbind(0), soup.y.unbind(0), torch.float64)
    keep = torch.minimum(c1 - c0, r1 - r0) >= 0
    if skip is not None:
        keep &= ~skip
    if cull is True:
        keep &= area <= (0 if small else _SURE)
    elif cull is not False:
        keep &= (area <= (0 if small else _SURE)) | ~cull
    if small:
        keep &= area != 0
        index = keep.nonzero().view(-1)
        return [(Candidates(index, _pick(box, index), area.index_select(0, index) > 0), torch.float64)]
    large = torch.maximum(*(t.amax(0) - t.amin(0) for t in (soup.x, soup.y))) >= EXACT_EXTENT
    result = []
    for exact, chosen in ((torch.float64, keep & ~large), (torch.int64, keep & large)):
        index = chosen.nonzero().view(-1)
        own = [tuple(row.index_select(0, index) for row in t) for t in (soup.x, soup.y)]
        area = _doubled_area(*own, torch.int64)
        real = area != 0
        if cull is not False:
            real &= area < 0 if cull is True else (area < 0) | ~cull.index_select(0, index)
        index = index[real]
        if len(index):
            result.append((Candidates(index, _pick(box, index), area[real] > 0), exact))
    return result


def _doubled_area(x: tuple[Tensor, ...], y: tuple[Tensor, ...], dtype: torch.dtype) -> Tensor:
    """Twice the signed area of triangles given corner by corner; positive where clockwise on a screen with y down."""
    d1x, d2x, d1y, d2y = ((c[i] - c[0]).to(dtype) for c in (x, y) for i in (1, 2))
    return (d1x * d2y).sub_(d1y * d2x)


def _pick(tensors: tuple[Tensor, ...], index: Tensor) -> tuple[Tensor, ...]:
    return tuple(t.index_select(0, index) for t in tensors)
