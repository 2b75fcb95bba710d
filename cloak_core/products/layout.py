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
    if own_pattern:
        corners, chart = pattern_pieces(bodies, chosen, areas)
    else:
        corners, chart = unwrap(points, index.reshape(-1, 3))
    stretch = stretches(points[index.reshape(-1, 3)].astype(np.float64), corners)
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


def unwrap(
    points: Float[np.ndarray, "v 3"], triangles: Integer[np.ndarray, "t 3"]
) -> tuple[Float[np.ndarray, "t 3 2"], Integer[np.ndarray, " t"]]:
    """Unwrap triangles: flat corners in metres, and the chart of every triangle."""
    import xatlas

    atlas = new_atlas()
    atlas.add_mesh(points.astype(np.float32), triangles.astype(np.uint32))
    atlas.generate(xatlas.ChartOptions(), pack_options())
    flat, index = sheet(atlas)
    chart = np.zeros(len(index), np.int64)
    for number in range(atlas.get_mesh_chart_count(0)):
        chart[atlas.get_mesh_chart(0, number).faces] = number
    return pack(flat, index, chart), chart


def pattern_pieces(
    bodies: Bodies, chosen: Integer[np.ndarray, " t"], areas: Float[np.ndarray, " t"]
) -> tuple[Float[np.ndarray, "t 3 2"], Integer[np.ndarray, " t"]]:
    """Take the pieces of the mesh's own UV map: flat corners in metres, the piece of every triangle. InputError."""
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
    of_vertex = np.zeros(len(flat), np.int64)
    of_vertex[index] = chart[:, None]
    return pack(flat * scale[of_vertex][:, None], index, chart), chart


def pack(
    flat: Float[np.ndarray, "v 2"], index: Integer[np.ndarray, "t 3"], chart: Integer[np.ndarray, " t"]
) -> Float[np.ndarray, "t 3 2"]:
    """Pack charts (metres, wherever they lie) side by side: none mirrored, none wider than high."""
    import xatlas

    mirrored = np.bincount(chart, weights=signed_areas(flat[index])) < 0
    of_vertex = np.zeros(len(flat), np.int64)
    of_vertex[index] = chart[:, None]
    flat = np.where(mirrored[of_vertex][:, None], flat * [-1, 1], flat)
    stand_up(flat, of_vertex)
    # Turned, charts lie on each other; so do pieces that share their place on a map.
    atlas = new_atlas()
    atlas.add_uv_mesh(apart(flat, of_vertex).astype(np.float32), index.astype(np.uint32))
    atlas.generate(xatlas.ChartOptions(), pack_options())
    packed, again = sheet(atlas)
    # xatlas rounds sizes to its pixels: it says where charts go, and they keep their own size.
    lowest = [lows(points.reshape(-1, 2), np.repeat(chart, 3)) for points in (flat[index], packed[again])]
    return flat[index] + (lowest[1] - lowest[0])[chart][:, None] + GAP / 2


def lows(points: Float[np.ndarray, "n 2"], chart: Integer[np.ndarray, " n"]) -> Float[np.ndarray, "charts 2"]:
    """Find each chart's lower left corner."""
    lowest = np.full((int(chart.max()) + 1, 2), np.inf)
    np.minimum.at(lowest, chart, points)
    return lowest


def welded(points: Float[np.ndarray, "n d"], within: float) -> Integer[np.ndarray, " n"]:
    """Number the points, the same for those at one place: files part vertices where other things differ."""
    return np.unique(np.round(points / within).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)


def apart(flat: Float[np.ndarray, "v 2"], chart: Integer[np.ndarray, " v"]) -> Float[np.ndarray, "v 2"]:
    """Put charts in a row, without touching."""
    low, high = lows(flat, chart), -lows(-flat, chart)
    start = np.concatenate([[0.0], np.cumsum(high[:-1, 0] - low[:-1, 0] + GAP)])
    return flat - low[chart] + np.stack([start, np.zeros(len(start))], axis=1)[chart]


def stand_up(flat: Float[np.ndarray, "v 2"], chart: Integer[np.ndarray, " v"]) -> None:
    """Turn charts that are wider than high by a quarter, in place: upright paper takes them in fewer pieces."""
    for number in range(int(chart.max()) + 1):
        corners = flat[chart == number]
        width, height = np.ptp(corners, axis=0)
        if width > height:
            flat[chart == number] = corners[:, ::-1] * [-1, 1]


def pack_options() -> xatlas.PackOptions:
    import xatlas

    options = xatlas.PackOptions()
    options.texels_per_unit = PACKING_DPI / 0.0254
    options.padding = int(np.ceil(GAP * options.texels_per_unit))
    # xatlas turns charts by swapping their axes, which mirrors them.
    options.rotate_charts = options.rotate_charts_to_axis = False
    return options


def sheet(atlas: xatlas.Atlas) -> tuple[np.ndarray, np.ndarray]:
    """Read flat vertices in metres [N, 2], and triangles [T, 3] in the order they were given in."""
    _, index, uv = atlas[0]
    return uv.astype(np.float64) * [atlas.width, atlas.height] / atlas.texels_per_unit, index.astype(np.int64)


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
