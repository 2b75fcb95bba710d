"""From the fragments of a batch to its views' matrices: by torch operations from lit ones, or by loops all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from cloak_core.render.compiled import arrays
from cloak_core.render.sparse import offsets
from cloak_core.render.threads import spread
from cloak_core.render.visibility.projection import Screen
from cloak_core.render.weights.fragments import Fragments
from cloak_core.render.weights.matrix_loops import material, matrix
from cloak_core.render.weights.shading import Light
from cloak_core.render.weights.view import View


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
    place = lit.view * total + lit.pixel
    places, row = torch.unique_consecutive(place, return_inverse=True)
    fold = lambda t: torch.zeros(len(places), dtype=t.dtype, device=t.device).index_add_(0, row, t)
    coverage, highlight = fold(lit.area), fold(lit.highlight)
    face, weight, uv = lit.face, lit.weight, lit.uv
    if split_faces and uv is None:  # triangles of one polygon may lie far apart on a texture
        row, face, weight = _merge_faces(row, face, weight)
    crow = offsets(row, len(places))
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


def view_by_loops(
    bands: Sequence[Fragments],
    screen: Screen,
    triangles: Int64[Tensor, "3 T"],
    triangle_face: Int64[Tensor, " T"],
    normals: Float32[Tensor, "3 B=1 V"],
    lights: Float32[Tensor, "3 B=1"],
    light: Light,
    corner_uv: Float32[Tensor, "2 3 T"] | None,
    split_faces: bool,
    count: int,
) -> View:
    """Light and matrix of the one view on the screen, whose bands of fragments (from top to bottom) `count` threads
    share; the other arguments as for `light_fragments` and `assemble`."""
    textured = corner_uv is not None
    space = np.stack([axis[0].numpy() for axis in screen.view])
    camera = float(screen.focal), screen.width / 2, screen.height / 2
    corner, face_of, normal, position = arrays(triangles, triangle_face, normals[:, 0], lights[:, 0])
    uv_of = arrays(corner_uv)[0] if textured else np.empty((2, 3, 0), np.float32)
    about = normal, position, material(light), uv_of, face_of, split_faces and not textured

    def rows_of(found: Fragments) -> tuple:
        places = arrays(found.pixel, found.triangle, found.area, found.x, found.y)
        return matrix(*places, corner, space, camera, *about)

    parts = spread(rows_of, bands, count)
    pixels, coverage, specular = (_join([rows[i] for rows, _ in parts]) for i in range(3))
    face, weight, uv = (_join([entries[i] for _, entries in parts]) for i in range(3))
    before = np.cumsum([0, *(rows[3][-1] for rows, _ in parts)])
    crow = _join([rows[3][i > 0 :] + before[i] for i, (rows, _) in enumerate(parts)])
    return View(screen.height, screen.width, pixels, coverage, specular, crow, face, weight, uv if textured else None)


def _join(parts: list[np.ndarray]) -> Tensor:
    return torch.from_numpy(parts[0] if len(parts) == 1 else np.concatenate(parts, -1))


def _merge_faces(row: Tensor, face: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sum the weights of a polygon's triangles within each pixel."""
    count = int(face.max()) + 1 if len(face) else 1
    entry, inverse = torch.unique(row * count + face, return_inverse=True)
    row = torch.div(entry, count, rounding_mode="floor")
    return row, entry - row * count, weight.new_zeros(len(entry)).index_add_(0, inverse, weight)
