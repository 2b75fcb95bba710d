# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of a surface are seen in a projection: numpy alone, because a ray from Python takes thirty microseconds.

Plane coordinates [n, 3]: x and y in the projection's plane, and an inverse depth that grows towards the viewer and is
linear over each triangle's image.
"""

from collections.abc import Callable, Iterator

import numpy as np

TOLERANCE = 1e-6
"""Two surfaces count as one if their inverse depths differ by less than this share of the points' range."""
MAX_PAIRS = 2_000_000  # of triangles and points, or cells, that are looked at together


def seen(
    points: np.ndarray, faces: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, triangle_face: np.ndarray
) -> np.ndarray:
    """Mask [n] of the points [n, 3] on their own faces [n] that no triangle of another face lies before.

    The triangles [T, 3] of faces [T] index plane coordinates `vertices` [V, 3].
    """
    visible = np.ones(len(points), bool)
    corners = [vertices[triangles[:, corner]] for corner in range(3)]
    least, most = np.minimum.reduce(corners), np.maximum.reduce(corners)
    tolerance = TOLERANCE * max(float(np.ptp(points[:, 2])) if len(points) else 0.0, 1e-30)
    for triangle, point in meetings(least[:, :2], most[:, :2], points[:, :2]):
        matters = (triangle_face[triangle] != faces[point]) & (most[triangle, 2] > points[point, 2])
        triangle, point = triangle[matters], point[matters]
        around = [corner[triangle] - points[point] for corner in corners]
        parts = areas_around_origin(*around)
        area = parts.sum(0)
        covers = ((parts.min(0) >= 0) | (parts.max(0) <= 0)) & (area != 0)
        ahead = sum(part * corner[:, 2] for part, corner in zip(parts, around, strict=True)) / np.where(covers, area, 1)
        visible[point[covers & (ahead > tolerance)]] = False
    return visible


def meetings(low: np.ndarray, high: np.ndarray, places: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of boxes, by their corners [B, 2], and places [n, 2] that may lie in them: all that share a cell of a grid.

    Yields indices of boxes and of places, some millions at a time.
    """
    side = int(min(len(low), len(places)) ** 0.5)
    if not side:
        return
    first = places.min(0)
    cell = np.maximum(np.ptp(places, axis=0) / side, 1e-30)

    def cell_of(points: np.ndarray) -> np.ndarray:
        return np.clip(np.floor((points - first) / cell), 0, side - 1).astype(np.int64)

    own = cell_of(places) @ np.array([1, side])
    order, count = np.argsort(own), np.bincount(own, minlength=side * side)
    start = np.cumsum(count) - count
    # The cells under each bounding box, one after the other, and the box of each.
    lowest, highest = cell_of(low), cell_of(high)
    columns, rows = (highest - lowest + 1).T
    box, place = ranges(np.arange(len(low)), np.zeros(len(low), np.int64), columns * rows)
    cells = lowest[box, 0] + place % columns[box] + side * (lowest[box, 1] + place // columns[box])
    some = np.flatnonzero(count[cells])
    total = int(count[cells].sum())
    for part in np.array_split(some, 1 + total // MAX_PAIRS):
        boxes, place = ranges(box[part], start[cells[part]], count[cells[part]])
        yield boxes, order[place]


def depth_buffer(
    points: np.ndarray,
    triangles: np.ndarray,
    shape: tuple[int, int],
    tell: Callable[[float], None] = lambda share: None,
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth [H, W] of the nearest triangle in the middle of each cell (-inf: none), and its number (-1: none).

    points: plane coordinates [V, 3], x and y counted in cells. shape: how many cells there are (width, height).
    tell: called with the share of the rows that is done.
    """
    width, height = shape
    # Corner by corner, [3, T], over which numpy is ten times as quick as over [T, 3]. Most triangles of a fine mesh
    # meet no row of middles and are dropped first.
    y = points[:, 1].astype(np.float64)[triangles.T] - 0.5
    first_row, last_row = np.ceil(y.min(0)), np.floor(y.max(0))
    drawn = np.flatnonzero((first_row <= last_row) & (first_row <= height - 1) & (last_row >= 0))
    corners = triangles[drawn].T
    x, z = (points[:, axis].astype(np.float64)[corners] - middle for axis, middle in ((0, 0.5), (2, 0)))
    y, low, high = y[:, drawn], np.maximum(first_row[drawn], 0), np.minimum(last_row[drawn], height - 1)
    (right, up, rise), (right2, up2, rise2) = ([v[i] - v[0] for v in (x, y, z)] for i in (1, 2))
    area = right * up2 - right2 * up
    slopes = np.stack([rise * up2 - rise2 * up, right * rise2 - right2 * rise]) / np.where(area == 0, 1, area)
    # Scanlines: each row of middles that a triangle reaches, and between which of its sides it lies there.
    shown = np.flatnonzero(area)
    triangle, row = ranges(shown, low[shown].astype(np.int64), (high - low)[shown].astype(np.int64) + 1)
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        ya, yb, xa = y[a, triangle], y[b, triangle], x[a, triangle]
        crossed = (np.minimum(ya, yb) <= row) & (row <= np.maximum(ya, yb)) & (ya != yb)
        at = xa + (row - ya) * (x[b, triangle] - xa) / np.where(crossed, yb - ya, 1)
        left, right = np.where(crossed, np.minimum(left, at), left), np.where(crossed, np.maximum(right, at), right)
    first = np.clip(np.ceil(left), 0, width).astype(np.int64)
    count = np.maximum(np.clip(np.floor(right), -1, width - 1).astype(np.int64) - first + 1, 0)
    nearness, owner = np.full(width * height, -np.inf), np.full(width * height, -1, np.int32)
    # Some rows at a time: those of an image of 4096 x 4096 together would take gigabytes.
    groups = np.flatnonzero(np.diff(np.cumsum(count) // MAX_PAIRS)) + 1
    for start, end in zip([0, *groups], [*groups, len(row)], strict=True):
        span, column = ranges(np.arange(start, end), first[start:end], count[start:end])
        cell, of = row[span] * width + column, triangle[span]
        depth = z[0, of] + slopes[0, of] * (column - x[0, of]) + slopes[1, of] * (row[span] - y[0, of])
        order = np.argsort(depth, kind="stable")  # of several values for one cell the last one written stays
        order = order[depth[order] >= nearness[cell[order]]]
        nearness[cell[order]], owner[cell[order]] = depth[order], drawn[of[order]]
        tell(end / max(1, len(row)))
    return nearness.reshape(height, width), owner.reshape(height, width)


def ranges(owners: np.ndarray, first: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each owner repeated `counts` times, beside first, first + 1, ..."""
    places = np.arange(counts.sum()) + np.repeat(first - (np.cumsum(counts) - counts), counts)
    return np.repeat(owners, counts), places


def areas_around_origin(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """[3, n]: twice the signed areas that the origin spans with the sides across from each corner [n, 2 or more].

    Divided by their sum they are the origin's barycentric coordinates.
    """
    return np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((b, c), (c, a), (a, b))])
