"""From the lit fragments of a batch to its views' matrices."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from cloak_core.render.compiled import arrays, use_loops
from cloak_core.render.dressing import View
from cloak_core.render.fragments_loops import fold
from cloak_core.render.projection import Screen
from cloak_core.render.sparse import offsets


@dataclass(frozen=True, eq=False)
class Lit:
    """N fragments with their faces and light, sorted by view and pixel."""

    view: Int64[Tensor, " N"]
    pixel: Int64[Tensor, " N"]
    area: Float32[Tensor, " N"]
    face: Int64[Tensor, " N"]
    weight: Float32[Tensor, " N"]
    highlight: Float32[Tensor, " N"]
    uv: Float32[Tensor, "2 N"] | None
    """Texture coordinates, where the bodies have some."""

    @staticmethod
    def join(bands: list[Lit]) -> Lit:
        """Of bands of one view, from top to bottom."""
        if len(bands) == 1:
            return bands[0]
        columns = ([getattr(band, field.name) for band in bands] for field in fields(Lit))
        return Lit(*(None if column[0] is None else torch.cat(column, -1) for column in columns))


def assemble(lit: Lit, screen: Screen, split_faces: bool) -> list[View]:
    """Cut the fragments of a batch into its views' matrices."""
    batch, total = len(screen.x), screen.width * screen.height
    rows_of = _fold_by_loops if use_loops(lit.view.device) else _fold
    # Triangles of one polygon may lie far apart on a texture.
    places, coverage, highlight, crow, face, weight, uv = rows_of(lit, total, split_faces and lit.uv is None)
    first = torch.searchsorted(places, torch.arange(batch + 1, device=places.device) * total)
    row_ends, entry_ends = first.tolist(), crow.index_select(0, first).tolist()
    views = []
    for index in range(batch):
        rows = slice(row_ends[index], row_ends[index + 1])
        entries = slice(entry_ends[index], entry_ends[index + 1])
        pixels = places[rows] - index * total
        own_crow = crow[rows.start : rows.stop + 1] - entries.start
        parts = (t.clone() for t in (coverage[rows], highlight[rows]))
        matrix = [t[..., entries].clone() if t is not None else None for t in (face, weight, uv)]
        views.append(View(screen.height, screen.width, pixels, *parts, own_crow, *matrix))
    return views


def _fold(lit: Lit, total: int, by_face: bool) -> tuple[Tensor | None, ...]:
    """Places (view * total + pixel), their coverage and highlight; row offsets, face, weight and uv of entries."""
    places, row = torch.unique_consecutive(lit.view * total + lit.pixel, return_inverse=True)
    total_of = lambda t: torch.zeros(len(places), dtype=t.dtype, device=t.device).index_add_(0, row, t)
    coverage, highlight = total_of(lit.area), total_of(lit.highlight)
    face, weight = lit.face, lit.weight
    if by_face:
        row, face, weight = _merge_faces(row, face, weight)
    return places, coverage, highlight, offsets(row, len(places)), face, weight, lit.uv


def _fold_by_loops(lit: Lit, total: int, by_face: bool) -> tuple[Tensor | None, ...]:
    place = lit.view * total + lit.pixel
    count = len(place)
    places, crow, face = np.empty(count, np.int64), np.empty(count + 1, np.int64), np.empty(count, np.int64)
    coverage, highlight, weight = np.empty((3, count), np.float32)
    uv = np.empty((2, 0 if lit.uv is None else count), np.float32)
    rows, entries = fold(
        *arrays(place, lit.area, lit.highlight, lit.face, lit.weight),
        uv if lit.uv is None else arrays(lit.uv)[0],
        by_face, places, coverage, highlight, crow, face, weight, uv,
    )  # fmt: skip
    put = lambda array, length: torch.from_numpy(array[..., :length])
    of_rows = (put(array, rows) for array in (places, coverage, highlight))
    of_entries = (put(array, entries) for array in (face, weight))
    return *of_rows, put(crow, rows + 1), *of_entries, None if lit.uv is None else put(uv, entries)


def _merge_faces(row: Tensor, face: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sum the weights of a polygon's triangles within each pixel."""
    count = int(face.max()) + 1 if len(face) else 1
    entry, inverse = torch.unique(row * count + face, return_inverse=True)
    row = torch.div(entry, count, rounding_mode="floor")
    return row, entry - row * count, weight.new_zeros(len(entry)).index_add_(0, inverse, weight)
