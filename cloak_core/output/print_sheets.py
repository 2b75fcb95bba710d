"""Print sheets: a PDF with every chart at true size, its name, a scale bar and cutting lines, on A4 or A3."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from cloak_core.exchange.bodies import Bodies
from cloak_core.output.baking import PADDING, Texture
from cloak_core.output.layout import Layout
from cloak_core.output.seams import Mark, find_borders, seam_marks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch

PAGES = {"A4": (0.210, 0.297), "A3": (0.297, 0.420)}
"""Width and height in metres, upright."""
POINTS = 72 / 0.0254
"""In a metre."""
MARGIN = 0.010
FOOT = 0.020
"""Height of the line with name and scale bar, above the lower margin."""
LINE = 0.0005
"""Metres beside a cutting line."""
TICK = 0.004
"""Metres from a seam to the end of a mark where there is no allowance to draw it in."""
OVERLAP = 0.010
"""Metres that neighbouring sheets of one chart show twice, for gluing."""


@dataclass(frozen=True)
class Tile:
    """One chart, or the part of it that fits one page: its window on the layout (metres), and which part it is."""

    chart: int
    low: tuple[float, float]
    high: tuple[float, float]
    column: int
    row: int
    columns: int
    rows: int


def tiles(layout: Layout, page: str, allowance: float = 0.0) -> list[Tile]:
    """Every chart, with so much (metres) around it, cut into windows that fit a page, large charts first."""
    width, height = PAGES[page]
    around = max(PADDING, allowance + LINE)
    room = np.array([width - 2 * MARGIN, height - 2 * MARGIN - FOOT])
    found = []
    for chart in range(layout.chart_count):
        corners = layout.corners[layout.chart == chart].reshape(-1, 2)
        low, high = corners.min(axis=0) - around, corners.max(axis=0) + around
        extent = high - low
        count = np.maximum(np.ceil((extent - OVERLAP) / (room - OVERLAP)), 1).astype(int)
        for row in range(count[1]):
            for column in range(count[0]):
                start = low + np.array([column, row]) * (room - OVERLAP)
                end = np.minimum(start + room, high)
                found.append(Tile(chart, tuple(start), tuple(end), column, row, *count.tolist()))
    return found


def pages(found: list[Tile], page: str) -> Iterator[list[tuple[Tile, float, float]]]:
    """Tiles side by side in rows on pages: (tile, x, y of its lower left corner in metres from the page's)."""
    width, height = PAGES[page]
    placed: list[tuple[Tile, float, float]] = []
    x, top, deep = MARGIN, height - MARGIN, 0.0
    for tile in sorted(found, key=lambda t: t.low[1] - t.high[1]):
        wide, high = tile.high[0] - tile.low[0], tile.high[1] - tile.low[1]
        if x > MARGIN and x + wide > width - MARGIN + 1e-9:
            x, top, deep = MARGIN, top - deep - 0.006, 0.0
        if placed and top - high < MARGIN + FOOT - 1e-9:
            yield placed
            placed, x, top, deep = [], MARGIN, height - MARGIN, 0.0
        placed.append((tile, x, top - high))
        x, deep = x + wide + 0.006, max(deep, high)
    if placed:
        yield placed


def chart_names(layout: Layout, bodies: Bodies) -> list[str]:
    """A name per chart: its number, and the region that most of it lies in (the smallest region, where several do)."""
    names = []
    for chart in range(layout.chart_count):
        faces = bodies.triangle_face[layout.triangles[layout.chart == chart]]
        inside = {name: mask[faces].mean() for name, mask in bodies.regions.items() if name != "front"}
        likely = [name for name, share in inside.items() if share > 0.5]
        best = min(likely, key=lambda name: bodies.regions[name].sum(), default="")
        names.append(f"{chart + 1} {best}".strip())
    return names


def write_sheets(
    path: Path, bodies: Bodies, layout: Layout, texture: Texture, page: str, title: str, allowance: float = 0.0
) -> dict[str, int]:
    """Write the PDF; returns its number of `pages`, and how many `marks` there are along seams.

    allowance: metres of cloth to leave around each chart; cutting lines then run at its end.
    """
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    borders, marks = find_borders(layout, bodies), seam_marks(layout, bodies)
    charts = [
        Chart(name, borders.lines[borders.chart == number], [mark for mark in marks if mark.chart == number])
        for number, name in enumerate(chart_names(layout, bodies))
    ]
    all_pages = list(pages(tiles(layout, page, allowance), page))
    size = PAGES[page]
    with PdfPages(path, metadata={"Creator": "cloak", "Producer": None, "CreationDate": None}) as pdf:
        for number, placed in enumerate(all_pages, start=1):
            figure = Figure(figsize=(size[0] / 0.0254, size[1] / 0.0254))
            axes = figure.add_axes((0, 0, 1, 1), xlim=(0, size[0]), ylim=(0, size[1]))
            axes.axis("off")
            for tile, x, y in placed:
                draw_tile(axes, layout, texture, charts[tile.chart], tile, (x, y), allowance)
            draw_foot(axes, f"{title}, {page}, page {number} of {len(all_pages)}; print at 100 %")
            axes.set(xlim=(0, size[0]), ylim=(0, size[1]))
            pdf.savefig(figure)
    return {"pages": len(all_pages), "marks": len({mark.name for mark in marks})}


@dataclass(frozen=True, eq=False)
class Chart:
    """What is drawn around one chart's colours."""

    name: str
    border: np.ndarray
    """[E, 2, 2] metres on the sheet."""
    marks: list[Mark]


def draw_tile(
    axes: Axes, layout: Layout, texture: Texture, chart: Chart, tile: Tile, at: tuple[float, float], allowance: float
) -> None:
    """One chart's window: its colours inside its border, the allowance around it, marks, and its name."""
    from matplotlib.patches import Rectangle

    shift = np.array(at) - tile.low
    frame = Rectangle(at, *np.subtract(tile.high, tile.low), fill=False, linewidth=0, transform=axes.transData)
    axes.add_patch(frame)
    if allowance:
        # The outline of a thick line is all that lies so far from the border.
        for width, color in ((allowance + LINE / 2, "black"), (allowance, "white")):
            draw_lines(axes, chart.border + shift, frame, color, 2 * width * POINTS)
    draw_colors(axes, layout, texture, tile, shift)
    draw_lines(axes, chart.border + shift, frame, "black", 0.4)
    draw_marks(axes, chart.marks, shift, frame, allowance or TICK)
    many = tile.columns * tile.rows > 1
    label = f"{chart.name}, part {tile.column + 1}-{tile.row + 1} of {tile.columns} x {tile.rows}"
    middle = (np.array(at) + np.subtract(tile.high, tile.low) / 2).tolist()
    box = {"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 1}
    axes.text(*middle, label if many else chart.name, fontsize=6, ha="center", va="center", bbox=box, zorder=4)


def draw_colors(axes: Axes, layout: Layout, texture: Texture, tile: Tile, shift: Float[np.ndarray, " 2"]) -> None:
    """The texture within a window, where this chart is."""
    from matplotlib.path import Path as Outline

    dots = texture.chart_rows / layout.size[1]
    x0, y0 = np.floor(np.array(tile.low) * dots).astype(int).clip(0)
    x1, y1 = np.ceil(np.array(tile.high) * dots).astype(int)
    y1, x1 = min(y1, texture.chart_rows), min(x1, texture.image.shape[1])
    crop = texture.image[texture.chart_rows - y1 : texture.chart_rows - y0, x0:x1]
    extent = np.array([x0, x1, y0, y1]) / dots + np.repeat(shift, 2)
    picture = axes.imshow(crop, extent=extent, interpolation="none", origin="upper", aspect="auto", zorder=2)
    # Neighbouring charts reach into the window: show only this one's triangles.
    mine = layout.corners[layout.chart == tile.chart] + shift
    closed = np.concatenate([mine, mine[:, :1]], axis=1).reshape(-1, 2)
    codes = np.tile([Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY], len(mine))
    picture.set_clip_path(Outline(closed, codes), axes.transData)


def draw_lines(axes: Axes, lines: Float[np.ndarray, "n 2 2"], frame: Patch, color: str, width: float) -> None:
    """Lines within a window; width in points."""
    from matplotlib.collections import LineCollection

    collection = LineCollection(lines, colors=color, linewidths=width, capstyle="round", zorder=1 if width > 1 else 3)
    axes.add_collection(collection)
    collection.set_clip_path(frame)  # afterwards: adding resets it


def draw_marks(axes: Axes, marks: list[Mark], shift: Float[np.ndarray, " 2"], frame: Patch, length: float) -> None:
    """A tick from the seam outwards, and its name."""
    if not marks:
        return
    points = np.stack([mark.point for mark in marks]) + shift
    ends = points + length * np.stack([mark.outwards for mark in marks])
    draw_lines(axes, np.stack([points, ends], axis=1), frame, "black", 0.6)
    for mark, (x, y) in zip(marks, points - 0.003 * np.stack([mark.outwards for mark in marks]), strict=True):
        box = {"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 0.3}
        text = axes.text(x, y, mark.name, fontsize=4, ha="center", va="center", bbox=box, zorder=4)
        text.set_clip_path(frame)
        text.set_clip_on(True)


def draw_foot(axes: Axes, text: str) -> None:
    """A bar of 100 mm with marks every 10 mm, and a line of text."""
    for mark in range(10):
        color = "black" if mark % 2 == 0 else "white"
        axes.fill_between([MARGIN + mark * 0.01, MARGIN + (mark + 1) * 0.01], MARGIN, MARGIN + 0.003, color=color)
    axes.plot(
        [MARGIN, MARGIN + 0.1, MARGIN + 0.1, MARGIN, MARGIN], MARGIN + np.array([0, 0, 3, 3, 0]) / 1e3, "k", lw=0.4
    )
    axes.text(MARGIN + 0.102, MARGIN, "100 mm", fontsize=6)
    axes.text(MARGIN, MARGIN + 0.006, text, fontsize=7)
