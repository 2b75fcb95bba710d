"""A flat layout of a logo at true scale, by xatlas: charts with little stretch, none mirrored, none overlapping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Integer

from cloak_core.exchange.bodies import Bodies
from cloak_core.scene.geometry import area_vectors

if TYPE_CHECKING:
    import xatlas

PACKING_DPI = 36
"""Charts are packed by their pixels; finer ones only cost time."""
GAP = 0.003
"""Metres between charts, at least."""


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


def lay_out(bodies: Bodies, face_ids: Integer[np.ndarray, " logo"]) -> Layout:
    """Unwrap the faces of a logo as they are in the first pose."""
    chosen = np.flatnonzero(np.isin(bodies.triangle_face, face_ids))
    used, index = np.unique(bodies.triangles[chosen], return_inverse=True)
    points = bodies.vertices[0][used]
    corners, chart = unwrap(points, index.reshape(-1, 3))
    areas = np.linalg.norm(area_vectors(bodies, 0)[0][chosen], axis=1)
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


def unwrap(
    points: Float[np.ndarray, "v 3"], triangles: Integer[np.ndarray, "t 3"]
) -> tuple[Float[np.ndarray, "t 3 2"], Integer[np.ndarray, " t"]]:
    """Flat corners in metres and the chart of every triangle."""
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(points.astype(np.float32), triangles.astype(np.uint32))
    atlas.generate(xatlas.ChartOptions(), pack_options())
    flat, index = sheet(atlas)
    chart = np.zeros(len(index), np.int64)
    for number in range(atlas.get_mesh_chart_count(0)):
        chart[atlas.get_mesh_chart(0, number).faces] = number
    mirrored = np.bincount(chart, weights=signed_areas(flat[index])) < 0
    of_vertex = np.zeros(len(flat), np.int64)
    of_vertex[index] = chart[:, None]
    flat[mirrored[of_vertex], 0] *= -1
    stand_up(flat, of_vertex)
    # Turned, charts no longer fit their places: pack once more, from the charts as they are.
    again = xatlas.Atlas()
    again.add_uv_mesh((flat - flat.min(axis=0)).astype(np.float32), index.astype(np.uint32))
    again.generate(xatlas.ChartOptions(), pack_options())
    flat, index = sheet(again)
    return flat[index] + GAP / 2, chart


def stand_up(flat: Float[np.ndarray, "v 2"], chart: Integer[np.ndarray, " v"]) -> None:
    """Turn charts that are wider than high by a quarter, in place: upright paper takes them in fewer pieces."""
    for number in range(int(chart.max()) + 1):
        mine = flat[chart == number]
        width, height = np.ptp(mine, axis=0)
        if width > height:
            flat[chart == number] = mine[:, ::-1] * [-1, 1]


def pack_options() -> xatlas.PackOptions:
    import xatlas

    options = xatlas.PackOptions()
    options.texels_per_unit = PACKING_DPI / 0.0254
    options.padding = int(np.ceil(GAP * options.texels_per_unit))
    # xatlas turns charts by swapping their axes, which mirrors them.
    options.rotate_charts = options.rotate_charts_to_axis = False
    return options


def sheet(atlas: xatlas.Atlas) -> tuple[np.ndarray, np.ndarray]:
    """Flat vertices in metres [N, 2], and triangles [T, 3] in the order they were given in."""
    _, index, uv = atlas[0]
    return uv.astype(np.float64) * [atlas.width, atlas.height] / atlas.texels_per_unit, index.astype(np.int64)


def signed_areas(corners: Float[np.ndarray, "t 3 2"]) -> Float[np.ndarray, " t"]:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def stretches(solid: Float[np.ndarray, "t 3 3"], flat: Float[np.ndarray, "t 3 2"]) -> Float[np.ndarray, " t"]:
    """max(s, 1 / s) over the singular values s of the map that lays each triangle flat; 1 for degenerate triangles."""
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


def outlines(layout: Layout, bodies: Bodies, chart: int) -> Float[np.ndarray, "edges 2 2"]:
    """The edges at a chart's border: cutting lines, as pairs of points on the sheet."""
    mine = layout.chart == chart
    corners = layout.corners[mine]
    vertices = bodies.triangles[layout.triangles[mine]].astype(np.int64)
    ends = np.stack([vertices, np.roll(vertices, -1, axis=1)], axis=2).reshape(-1, 2)
    lines = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    keys = np.sort(ends, axis=1)
    _, inverse, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    return lines[count[inverse.reshape(-1)] == 1]


def inside(corners: Float[np.ndarray, "3 2"], points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """Which points lie in a counter-clockwise triangle or on its border."""
    result = np.ones(len(points), bool)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side = (end - start)[0] * (points[:, 1] - start[1]) - (end - start)[1] * (points[:, 0] - start[0])
        result &= side >= 0
    return result
