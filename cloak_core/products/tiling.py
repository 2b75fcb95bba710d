"""Charts on paper: windows that fit a page, none without cloth, packed onto as few pages as that takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt

from cloak_core.products.baking import PADDING
from cloak_core.products.layout import Layout

PAGES = {"A4": (0.210, 0.297), "A3": (0.297, 0.420), "Letter": (0.2159, 0.2794), "Tabloid": (0.2794, 0.4318)}
"""Width and height in metres, upright."""
MARGIN = 0.010
FOOT = 0.020
"""Height of the line with name and scale bar, above the lower margin."""
LINE = 0.0005
"""Metres beside a cutting line."""
OVERLAP = 0.010
"""Metres that neighbouring sheets of one chart show twice, for gluing."""
BETWEEN = 0.006
"""Metres between tiles on a page."""
CELL = 0.002
"""Metres: how finely it is told where a chart is."""
PLACES = [(x / 3, y / 3) for x in range(4) for y in range(4)]
"""Where the grid of windows is tried, as shares of the room that it leaves at a chart's ends."""


@dataclass(frozen=True)
class Tile:
    """One chart, or the part of it that fits one page: its window on the layout (metres), and which part it is."""

    chart: int
    low: tuple[float, float]
    high: tuple[float, float]
    part: int
    """From 1 on; 0 for a chart that is whole."""
    parts: int


@dataclass(frozen=True, eq=False)
class Cloth:
    """Where a chart is, with what is around it: cells of a grid, and the grid's lower left corner in metres."""

    cells: Bool[np.ndarray, "rows columns"]
    low: np.ndarray

    def inside(self, low: np.ndarray, high: np.ndarray) -> tuple[slice, slice]:
        """Find the cells of a window."""
        first = np.floor((low - self.low) / CELL + 1e-6).astype(int).clip(0)
        last = np.ceil((high - self.low) / CELL - 1e-6).astype(int).clip(0)
        return slice(first[1], last[1]), slice(first[0], last[0])


def tiles(layout: Layout, page: str, allowance: float = 0.0) -> list[Tile]:
    """Cut every chart, with so much (metres) around it, into windows that fit a page, large charts first.

    Together the windows show all of a chart; those that would show nothing, or only what others show, are left out,
    and each is no larger than what it shows.
    """
    width, height = PAGES[page]
    around = max(PADDING, allowance + LINE)
    room = np.array([width - 2 * MARGIN, height - 2 * MARGIN - FOOT])
    all_tiles = []
    for chart in range(layout.chart_count):
        cloth = cloth_of(layout, chart, around)
        extent = np.array(cloth.cells.shape[::-1]) * CELL
        count = np.maximum(np.ceil((extent - OVERLAP) / (room - OVERLAP) - 1e-9), 1).astype(int)
        slack = (count * (room - OVERLAP) + OVERLAP - extent).clip(0)
        grid = np.array([[x, y] for y in range(count[1]) for x in range(count[0])]) * (room - OVERLAP)
        tried = [_needed(cloth, cloth.low - slack * moved + grid, room) for moved in PLACES]
        kept = min(tried, key=lambda windows: (len(windows), sum(float(np.prod(b - a)) for a, b in windows)))
        many = len(kept) > 1
        all_tiles += [
            Tile(chart, tuple(low.tolist()), tuple(high.tolist()), many * number, len(kept))
            for number, (low, high) in enumerate(kept, start=1)
        ]
    return all_tiles


def cloth_of(layout: Layout, chart: int, around: float) -> Cloth:
    """Find where a chart is, with so much (metres) around it."""
    corners = layout.corners[layout.chart == chart]
    low, high = corners.reshape(-1, 2).min(axis=0) - around, corners.reshape(-1, 2).max(axis=0) + around
    columns, rows = np.ceil((high - low) / CELL - 1e-9).astype(int)
    picture = Image.new("1", (int(columns), int(rows)))
    draw = ImageDraw.Draw(picture)
    for triangle in (corners - low) / CELL - 0.5:
        draw.polygon(list(map(tuple, triangle.tolist())), fill=1, outline=1)
    near = distance_transform_edt(~np.asarray(picture)) <= around / CELL + 1
    return Cloth(near, low)


def _needed(
    cloth: Cloth, starts: Float[np.ndarray, "n 2"], room: Float[np.ndarray, " 2"]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Cut windows that begin there down to the cloth they show; drop those whose cloth others show."""
    cut = []
    for low, high in zip(starts, starts + room, strict=True):
        rows, columns = cloth.inside(low, high)
        there = cloth.cells[rows, columns]
        if there.any():
            y, x = (np.flatnonzero(there.any(axis=axis)) for axis in (1, 0))
            first = cloth.low + CELL * np.array([columns.start + x[0], rows.start + y[0]])
            last = cloth.low + CELL * np.array([columns.start + x[-1] + 1, rows.start + y[-1] + 1])
            cut.append((np.maximum(first, low), np.minimum(last, high)))
    shown = np.zeros(cloth.cells.shape, np.int32)
    for low, high in cut:
        shown[cloth.inside(low, high)] += 1
    kept = set(range(len(cut)))
    for index in sorted(kept, key=lambda i: float(np.prod(cut[i][1] - cut[i][0]))):
        place = cloth.inside(*cut[index])
        if len(kept) > 1 and (shown[place][cloth.cells[place]] > 1).all():
            shown[place] -= 1
            kept.remove(index)
    return [cut[index] for index in sorted(kept)]


def pages(all_tiles: list[Tile], page: str) -> list[list[tuple[Tile, float, float]]]:
    """Place tiles on pages in rows, the tallest first, each on the first page with room for it (shelf packing).

    Lists, for each page, (tile, x, y of its lower left corner in metres from the page's). Parts of a chart keep their
    numbers.
    """
    filled: list[Page] = []
    for tile in sorted(all_tiles, key=lambda t: t.low[1] - t.high[1]):
        if not any(sheet.takes(tile) for sheet in filled):
            filled.append(Page(page))
            filled[-1].takes(tile)
    return [sheet.tiles for sheet in filled]


class Page:
    """Rows of tiles, from the top down."""

    def __init__(self, page: str) -> None:
        self.right, self.free = PAGES[page][0] - MARGIN, PAGES[page][1] - MARGIN
        self.rows: list[list[float]] = []
        """Of each: where it is full up to, its top and its height."""
        self.tiles: list[tuple[Tile, float, float]] = []

    def takes(self, tile: Tile) -> bool:
        """Place a tile, if there is room for it."""
        wide, high = tile.high[0] - tile.low[0], tile.high[1] - tile.low[1]
        fits = [row for row in self.rows if row[0] + wide <= self.right + 1e-9 and high <= row[2] + 1e-9]
        top = self.free - BETWEEN * bool(self.rows)
        if not fits:
            if top - high < MARGIN + FOOT - 1e-9:
                return False
            fits = [[MARGIN, top, high]]
            self.rows += fits
            self.free = top - high
        row = fits[0]
        self.tiles.append((tile, row[0], row[1] - high))
        row[0] += wide + BETWEEN
        return True
