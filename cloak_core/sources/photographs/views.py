"""Views from photographs: a fitted person as a sparse linear map from a logo's colours to the pixels of an image.

The image is a square part of the photograph, resampled. Resampling is linear, so it is one more sparse matrix: pixels
of the image x pixels of the photograph, times pixels of the photograph x faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64, UInt8
from scipy import sparse
from torch import Tensor

from cloak_core.core.cameras import Number
from cloak_core.core.cloth import cloth_coordinates
from cloak_core.core.linear import SparseMap
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.compiled import use_loops
from cloak_core.sources.photographs.choosing import Box
from cloak_core.sources.photographs.fitting import Fit
from cloak_core.sources.photographs.resampling import Dressed, resample_dressed
from cloak_core.sources.photographs.rig import body_rig, faces_on_rig

PADDING = 0.5
"""Grey beyond the photograph's border."""
CONTEXT = 1.25
"""Side of the image that judges, in heights of the person's box."""


@dataclass(frozen=True)
class Framing:
    """Which part of a person's crop an image shows, and how it is resampled."""

    x: Number
    y: Number
    """Left top corner of the square, pixels of the crop; may lie outside."""
    side: Number
    size: int = 416
    """Pixels of the image."""
    mirror: bool = False
    softness: Number = 1.0
    """Width of the resampling kernel, 1: just enough against aliasing."""

    def box(self, box: Box) -> Box:
        """A box of the crop in pixels of the image."""
        x0, y0, x1, y1 = (
            (value - start) * self.size / self.side for value, start in zip(box, (self.x, self.y) * 2, strict=True)
        )
        return (self.size - x1, y0, self.size - x0, y1) if self.mirror else (x0, y0, x1, y1)


@dataclass(frozen=True)
class Looseness:
    """What a fit does not know: changes of it that training draws."""

    move: tuple[Number, Number] = (0.0, 0.0)
    """Of the faces on the person, in heights of her box, right and down."""
    stretch: tuple[Number, Number] = (1.0, 1.0)
    """Of the faces about her middle, across and along."""
    folds: Number = 1.0
    """Exponent of the shading."""
    exposure: Number = 1.0


def framing_of(fit: Fit, context: Number = CONTEXT, size: int = 416) -> Framing:
    """The square about a person that judges: `context` heights of her box, moved into the photograph where it fits."""
    x0, y0, x1, y1 = fit.person.box
    side = context * max(y1 - y0, x1 - x0)
    height, width = fit.person.shape
    inside = lambda start, most: min(max(start, 0.0), most - side) if side <= most else (most - side) / 2
    return Framing(inside((x0 + x1 - side) / 2, width), inside((y0 + y1 - side) / 2, height), side, size)


def logo_positions(topology: str, face_ids: Int64[np.ndarray, " L"]) -> Int64[np.ndarray, " T"]:
    """For each of the rig's triangles the position of its face in the logo; -1 where it is not of the logo."""
    face = faces_on_rig(topology)
    position = np.full(max(int(face.max()), int(face_ids.max())) + 1, -1)
    position[face_ids] = np.arange(len(face_ids))
    return np.where(face >= 0, position[face], -1)


def shares_of(
    fit: Fit, position: Int64[np.ndarray, " T"], logo_count: int, looseness: Looseness | None = None
) -> SparseMap:
    """The logo's part of a fit: its pixels x the logo's faces, each entry the face's share of the pixel."""
    crow, triangle, share = fit.crow, fit.triangle, fit.share
    if looseness is not None and (looseness.move != (0.0, 0.0) or looseness.stretch != (1.0, 1.0)):
        rows = _moved_rows(fit, looseness)
        counts = np.diff(crow)[rows]
        entry = np.repeat(crow[rows] - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        crow, triangle, share = np.concatenate([[0], np.cumsum(counts)]), triangle[entry], share[entry]
    face = position[triangle]
    kept = face >= 0
    before = np.concatenate([[0], np.cumsum(kept)])
    return SparseMap(
        torch.from_numpy(before[crow]), torch.from_numpy(face[kept]), torch.from_numpy(share[kept]), logo_count
    )


def cloth_places(fit: Fit) -> Float[np.ndarray, "P 2"]:
    """Find where each pixel of a fitted person lies on a cloth that her clothes are cut of: metres right and down."""
    return cloth_coordinates(fit.rest, body_rig().normals[fit.main])


def photograph_view(fit: Fit, worn: SparseMap, framing: Framing, looseness: Looseness | None = None) -> BakedView:
    """Bake a fitted person who wears something: a map of her pixels x colours, such as `shares_of` a logo.

    The base image is the photograph; the box is the person's; the provenance names photograph, person and the boxes of
    the other people in the image.
    """
    height, width = fit.person.shape
    down, across = _kernels(framing, height, width)
    size = framing.size
    shares = worn.to_scipy()
    resample = resample_dressed if use_loops(worn.crow.device) else _resample_dressed
    seen = resample(fit.person.image, fit.pixels, shares, _light(fit, looseness), down, across, PADDING)
    shown = len(seen.crow) - 1
    pixels, base_color, crow, column, weight = map(torch.from_numpy, seen)
    return BakedView(
        height=size,
        width=size,
        pixels=pixels,
        coverage=torch.ones(size * size),
        base_color=base_color,
        front_count=shown,
        map=SparseMap(crow, column, weight, shares.shape[1]),
        light_color=tuple(map(float, fit.tint)),
        box=framing.box(fit.person.box),
        provenance={"photograph": fit.person.photograph, "person": fit.person.name},
        others=tuple(framing.box(box) for box in fit.person.others),
    )


def person_mask(fit: Fit, framing: Framing) -> Bool[Tensor, "s s"]:
    """True where a pixel of the image shows the person by half or more."""
    down, across = _kernels(framing, *fit.person.shape)
    return torch.from_numpy(across @ (down @ fit.person.mask.astype(np.float32)).T >= 0.5).T


def _moved_rows(fit: Fit, looseness: Looseness) -> np.ndarray:
    """For each row of the fit the row whose faces it shows: its own where the move leads off the person."""
    height, width = fit.person.shape
    x0, y0, x1, y1 = fit.person.box
    x, y = fit.pixels % width, fit.pixels // width
    from_x = (x0 + x1) / 2 + (x - (x0 + x1) / 2) / looseness.stretch[0] - looseness.move[0] * (y1 - y0)
    from_y = (y0 + y1) / 2 + (y - (y0 + y1) / 2) / looseness.stretch[1] - looseness.move[1] * (y1 - y0)
    at = np.clip(np.rint(from_y), 0, height - 1).astype(int) * width + np.clip(np.rint(from_x), 0, width - 1).astype(
        int
    )
    row = np.full(height * width, -1)
    row[fit.pixels] = np.arange(len(fit.pixels))
    return np.where(row[at] >= 0, row[at], np.arange(len(fit.pixels)))


def _light(fit: Fit, looseness: Looseness | None) -> np.ndarray:
    return fit.shading if looseness is None else fit.shading**looseness.folds * looseness.exposure


def _kernels(framing: Framing, height: int, width: int) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Filters of a photograph of this size: down [size, height], and across [size, width]."""
    down = _kernel(framing.y, framing.side, framing.size, height, framing.softness, False)
    return down, _kernel(framing.x, framing.side, framing.size, width, framing.softness, framing.mirror)


def _kernel(start: Number, side: Number, size: int, count: int, softness: Number, mirror: bool) -> sparse.csr_matrix:
    """Triangle filter along one axis [size, count]: `size` pixels from `start` over `side` of `count` pixels.

    Rows add up to 1 where the filter lies within the picture, to less at its border, to 0 beyond.
    """
    scale = side / size
    reach = max(scale, 1.0) * softness
    centre = start + (np.arange(size) + 0.5) * scale - 0.5
    taps = int(np.ceil(2 * reach)) + 1
    column = np.floor(centre - reach).astype(int)[:, None] + 1 + np.arange(taps)
    weight = np.maximum(1 - np.abs(column - centre[:, None]) / reach, 0)
    weight /= weight.sum(axis=1, keepdims=True)
    row = np.broadcast_to((np.arange(size)[::-1] if mirror else np.arange(size))[:, None], column.shape)
    kept = (column >= 0) & (column < count) & (weight > 0)
    return sparse.csr_matrix((weight[kept], (row[kept], column[kept])), shape=(size, count))


def _resample_dressed(
    image: UInt8[np.ndarray, "H W 3"],
    pixels: Int64[np.ndarray, " P"],
    worn: sparse.csr_matrix,
    light: Float[np.ndarray, " P"],
    down: sparse.csr_matrix,
    across: sparse.csr_matrix,
    padding: float,
) -> Dressed:
    """`resampling.resample_dressed` as sparse products, where there is no numba."""
    height, width, _ = image.shape
    size = down.shape[0]
    left = np.ones(height * width, np.float32)
    left[pixels] -= np.asarray(worn.sum(axis=1)).ravel()
    photograph = image.astype(np.float32) / 255 * left.reshape(height, width, 1)
    rows = (down @ photograph.reshape(height, -1)).reshape(-1, width, 3).transpose(1, 0, 2)
    resampled = (across @ rows.reshape(width, -1)).reshape(size, -1, 3).transpose(1, 0, 2)
    beyond = 1 - np.outer(down.sum(axis=1), across.sum(axis=1))
    base = (resampled + padding * beyond[..., None]).astype(np.float32).transpose(2, 0, 1).reshape(3, -1)
    shown = _pixels_to_pixels(pixels, width, down, across) @ (sparse.diags(light) @ worn)
    shown.sort_indices()  # within rows, far sooner than all entries at once
    is_worn = np.diff(shown.indptr) > 0
    order = np.concatenate([np.flatnonzero(is_worn), np.flatnonzero(~is_worn)])
    crow = np.concatenate([[0], shown.indptr[1:][is_worn]]).astype(np.int64)
    entries = shown.indices.astype(np.int64), shown.data.astype(np.float32)
    return Dressed(order, np.ascontiguousarray(base[:, order]), crow, *entries)


def _pixels_to_pixels(
    pixels: np.ndarray, width: int, down: sparse.csr_matrix, across: sparse.csr_matrix
) -> sparse.csr_matrix:
    """The two kernels as one matrix, pixels of the image x these pixels of the photograph."""
    ys, xs = down.tocsc(), across.tocsc()
    y, x = pixels // width, pixels % width
    first_y, first_x = ys.indptr[y], xs.indptr[x]
    many_y, many_x = ys.indptr[y + 1] - first_y, xs.indptr[x + 1] - first_x
    count = many_y * many_x
    source = np.repeat(np.arange(len(pixels)), count)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    at_y = first_y[source] + place // many_x[source]
    at_x = first_x[source] + place % many_x[source]
    size = down.shape[0]
    target = ys.indices[at_y].astype(np.int64) * size + xs.indices[at_x]
    return sparse.csr_matrix((ys.data[at_y] * xs.data[at_x], (target, source)), shape=(size * size, len(pixels)))
