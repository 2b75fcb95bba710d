"""A flat layout of a logo at true scale, by xatlas: charts with little stretch, none mirrored, none overlapping."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Integer
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cloak_core.core.geometry import area_vectors
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    import xatlas

PACKING_DPI = 36
"""Charts are packed by their pixels; finer ones only cost time."""
GAP = 0.003
"""Metres between charts, at least."""

SAME, SAME_UV = 1e-6, 1e-6
"""Metres, and units of the map, within which two corners are one."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Where a logo's triangles lie on a flat sheet: metres, x to the right, y up, seen from outside the body."""

    triangles: np.ndarray
    """[T] int64: which of the body's triangles."""
    corners: np.ndarray
    """[T, 3, 2] float64, counter-clockwise."""
    chart: np.ndarray
    """[T] int64, numbered from the largest chart down."""
    size: tuple[float, float]
    """Width and height of the sheet."""
    stretch_mean: float
    """How much longer or shorter than on the body lengths come out, in the worst direction; mean by area, 1 is none."""
    stretch_most: float
    """The same, 99th percentile by area."""
    used: float
    """Share of the sheet that the charts fill."""

    @property
    def chart_count(self) -> int:
        return int(self.chart.max()) + 1


def lay_out(bodies: Bodies, face_ids: Integer[np.ndarray, " logo"], own_pattern: bool = False) -> Layout:
    """Lay the faces of a logo flat as they are in the first pose.

    own_pattern: in the pieces of the mesh's own UV map, as a garment has them, each at the size that keeps its area;
    otherwise in charts that xatlas cuts. InputError: there is no such map, or it is of no use.
    """
    chosen = np.flatnonzero(np.isin(bodies.triangle_face, face_ids))
    used, index = np.unique(bodies.triangles[chosen], return_inverse=True)
    points = bodies.vertices[0][used]
    areas = np.linalg.norm(area_vectors(bodies, 0)[0][chosen], axis=1)
    index = index.reshape(-1, 3)
    flat, pieces, chart = pattern_pieces(bodies, chosen, areas) if own_pattern else unwrap(points, index)
    corners = pack(flat, pieces, chart)
    stretch = stretches(points[index].astype(np.float64), corners)
    order = np.argsort(stretch)
    below = np.cumsum(areas[order]) / areas.sum()
    size = corners.reshape(-1, 2).max(axis=0) + GAP / 2
    rank = np.argsort(np.argsort(-np.bincount(chart, weights=areas), kind="stable"))
    return Layout(
        triangles=chosen,
        corners=corners,
        chart=rank[chart],
        size=(float(size[0]), float(size[1])),
        stretch_mean=float((stretch * areas).sum() / areas.sum()),
        stretch_most=float(stretch[order][np.searchsorted(below, 0.99)]),
        used=float(areas.sum() / size.prod()),
    )


def new_atlas() -> xatlas.Atlas:
    """Make an atlas that is never taken away.

    Its destructor waits for a thread that it wakes without holding the lock: once in some thousand times the thread
    sleeps on, and the process with it. A few megabytes are the price.
    """
    import xatlas

    atlas = xatlas.Atlas()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(atlas))
    return atlas


def packed(atlas: xatlas.Atlas) -> tuple[Float[np.ndarray, "v 2"], Integer[np.ndarray, "t 3"]]:
    """Cut and pack an atlas: flat vertices in metres, and triangles in the order they were given in."""
    import xatlas

    options = xatlas.PackOptions()
    options.texels_per_unit = PACKING_DPI / 0.0254
    options.padding = int(np.ceil(GAP * options.texels_per_unit))
    # xatlas turns charts by swapping their axes, which mirrors them.
    options.rotate_charts = options.rotate_charts_to_axis = False
    atlas.generate(xatlas.ChartOptions(), options)
    _, index, uv = atlas[0]
    return uv.astype(np.float64) * [atlas.width, atlas.height] / atlas.texels_per_unit, index.astype(np.int64)


Charts = tuple[Float[np.ndarray, "flat 2"], Integer[np.ndarray, "t 3"], Integer[np.ndarray, " t"]]
"""Flat vertices in metres, wherever they lie; triangles; and the chart of every triangle."""


def unwrap(points: Float[np.ndarray, "v 3"], triangles: Integer[np.ndarray, "t 3"]) -> Charts:
    """Cut triangles into charts and lay these flat."""
    atlas = new_atlas()
    atlas.add_mesh(points.astype(np.float32), triangles.astype(np.uint32))
    flat, index = packed(atlas)
    chart = np.zeros(len(index), np.int64)
    for number in range(atlas.get_mesh_chart_count(0)):
        chart[atlas.get_mesh_chart(0, number).faces] = number
    return flat, index, chart


def pattern_pieces(bodies: Bodies, chosen: Integer[np.ndarray, " t"], areas: Float[np.ndarray, " t"]) -> Charts:
    """Take the pieces of the mesh's own UV map. InputError: there is none, or a piece has no area."""
    if bodies.uv is None or bodies.triangle_uv is None:
        raise InputError(f"{bodies.name}: has no UV map to take the pieces of")
    # Two triangles belong together where they share an edge both on the mesh and on the map.
    uv = welded(bodies.uv, SAME_UV)[bodies.triangle_uv[chosen]]
    corners = welded(bodies.vertices[0], SAME)[bodies.triangles[chosen]] * len(bodies.uv) + uv
    ends = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    owner = np.repeat(np.arange(len(chosen)), 3)
    edge = edge.reshape(-1)
    joined = coo_array((np.ones(len(edge)), (owner, len(chosen) + edge)), shape=(len(chosen) + edge.max() + 1,) * 2)
    chart = connected_components(joined, directed=False)[1][: len(chosen)]
    chart = np.unique(chart, return_inverse=True)[1].reshape(-1)
    _, first, index = np.unique(
        np.stack([np.repeat(chart, 3), corners.reshape(-1)], axis=1), axis=0, return_index=True, return_inverse=True
    )
    flat = bodies.uv[bodies.triangle_uv[chosen].reshape(-1)[first]].astype(np.float64)
    index = index.reshape(-1, 3)
    on_map = np.bincount(chart, weights=np.abs(signed_areas(flat[index])))
    if (on_map <= 1e-12).any():
        raise InputError(f"{bodies.name}: a piece of its UV map has no area")
    scale = np.sqrt(np.bincount(chart, weights=areas) / on_map)
    return flat * scale[chart_of_vertex(len(flat), index, chart)][:, None], index, chart


def pack(
    flat: Float[np.ndarray, "v 2"], index: Integer[np.ndarray, "t 3"], chart: Integer[np.ndarray, " t"]
) -> Float[np.ndarray, "t 3 2"]:
    """Pack charts side by side, none mirrored, none wider than high: flat corners of the triangles, metres."""
    of_vertex = chart_of_vertex(len(flat), index, chart)
    mirrored = np.bincount(chart, weights=signed_areas(flat[index])) < 0
    flat = np.where(mirrored[of_vertex][:, None], flat * [-1, 1], flat)
    # Upright paper takes upright charts in fewer pieces.
    width, height = (-lows(-flat, of_vertex) - lows(flat, of_vertex)).T
    flat = np.where((width > height)[of_vertex][:, None], flat[:, ::-1] * [-1, 1], flat)
    # Turned, charts lie on each other; so do pieces that share their place on a map: put them in a row.
    low, high = lows(flat, of_vertex), -lows(-flat, of_vertex)
    start = np.concatenate([[0.0], np.cumsum(high[:-1, 0] - low[:-1, 0] + GAP)])
    in_a_row = flat - low[of_vertex] + np.stack([start, np.zeros(len(start))], axis=1)[of_vertex]
    atlas = new_atlas()
    atlas.add_uv_mesh(in_a_row.astype(np.float32), index.astype(np.uint32))
    placed, again = packed(atlas)
    # xatlas rounds sizes to its pixels: it says where charts go, and they keep their own size.
    lowest = [lows(points.reshape(-1, 2), np.repeat(chart, 3)) for points in (flat[index], placed[again])]
    return flat[index] + (lowest[1] - lowest[0])[chart][:, None] + GAP / 2


def chart_of_vertex(
    count: int, index: Integer[np.ndarray, "t 3"], chart: Integer[np.ndarray, " t"]
) -> Integer[np.ndarray, " v"]:
    of_vertex = np.zeros(count, np.int64)
    of_vertex[index] = chart[:, None]
    return of_vertex


def lows(points: Float[np.ndarray, "n 2"], chart: Integer[np.ndarray, " n"]) -> Float[np.ndarray, "charts 2"]:
    """Find each chart's lower left corner."""
    lowest = np.full((int(chart.max()) + 1, 2), np.inf)
    np.minimum.at(lowest, chart, points)
    return lowest


def welded(points: Float[np.ndarray, "n d"], within: float) -> Integer[np.ndarray, " n"]:
    """Number the points, the same for those at one place: files part vertices where other things differ."""
    return np.unique(np.round(points / within).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)


def signed_areas(corners: Float[np.ndarray, "t 3 2"]) -> Float[np.ndarray, " t"]:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def stretches(solid: Float[np.ndarray, "t 3 3"], flat: Float[np.ndarray, "t 3 2"]) -> Float[np.ndarray, " t"]:
    """Measure each triangle's stretch: max(s, 1 / s) over the map's singular values; 1 for degenerate triangles."""
    along = solid[:, 1] - solid[:, 0]
    other = solid[:, 2] - solid[:, 0]
    length = np.linalg.norm(along, axis=1)
    fine = length > 1e-9
    unit = along / np.where(fine, length, 1)[:, None]
    x = (other * unit).sum(axis=1)
    y = np.linalg.norm(other - unit * x[:, None], axis=1)
    fine &= y > 1e-9
    edges = np.stack([flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]], axis=2)
    local = np.zeros((len(solid), 2, 2))
    local[:, 0, 0], local[:, 0, 1], local[:, 1, 1] = length, x, y
    local[~fine] = np.eye(2)
    edges[~fine] = np.eye(2)
    values = np.linalg.svd(edges @ np.linalg.inv(local), compute_uv=False)
    return np.maximum(values[:, 0], 1 / np.maximum(values[:, 1], 1e-9))
