"""Print sheets: a PDF with an overview, then every chart at true size, its name, a scale bar and cutting lines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from cloak_core.exchange.bodies import Bodies
from cloak_core.products.baking import Texture
from cloak_core.products.layout import Layout
from cloak_core.products.seams import Mark, find_borders, seam_marks
from cloak_core.products.tiling import FOOT, LINE, MARGIN, OVERLAP, PAGES, Tile, pages, tiles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch
    from matplotlib.text import Text


POINTS = 72 / 0.0254
"""In a metre."""
TICK = 0.004
"""Metres from a seam to the end of a mark where there is no allowance to draw it in."""


def chart_names(layout: Layout, bodies: Bodies) -> list[str]:
    """Name each chart: its number, and the smallest region that most of it lies in."""
    names = []
    for chart in range(layout.chart_count):
        faces = bodies.triangle_face[layout.triangles[layout.chart == chart]]
        inside = {name: mask[faces].mean() for name, mask in bodies.regions.items() if name != "front"}
        likely = [name for name, rate in inside.items() if rate > 0.5]
        best = min(likely, key=lambda name: bodies.regions[name].sum(), default="")
        names.append(f"{chart + 1} {best}".strip())
    return names


def write_sheets(
    path: Path, bodies: Bodies, layout: Layout, texture: Texture, page: str, title: str, allowance: float = 0.0
) -> dict[str, int]:
    """Write the PDF, its overview first; returns its number of `pages`, and how many `marks` there are along seams.

    allowance: metres of cloth to leave around each chart; cutting lines then run at its end.
    """
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    borders = find_borders(layout, bodies)
    marks = seam_marks(layout, bodies)
    charts = [
        Chart(name, borders.lines[borders.chart == number], [mark for mark in marks if mark.chart == number])
        for number, name in enumerate(chart_names(layout, bodies))
    ]
    all_tiles = tiles(layout, page, allowance)
    all_pages = pages(all_tiles, page)
    size = PAGES[page]
    count = len(all_pages) + 1
    with PdfPages(path, metadata={"Creator": "cloak", "Producer": None, "CreationDate": None}) as pdf:
        for number, placed in enumerate([[], *all_pages], start=1):
            figure = Figure(figsize=(size[0] / 0.0254, size[1] / 0.0254))
            axes = figure.add_axes((0, 0, 1, 1), xlim=(0, size[0]), ylim=(0, size[1]))
            axes.axis("off")
            if number == 1:
                draw_overview(axes, layout, texture, [chart.name for chart in charts], all_pages, page)
            for tile, x, y in placed:
                draw_tile(axes, layout, texture, charts[tile.chart], tile, (x, y), allowance)
                draw_glue_lines(axes, tile, [part for part in all_tiles if part.chart == tile.chart], (x, y))
            draw_foot(axes, f"{title}, {page}, page {number} of {count}; print at 100 %", bar=number > 1)
            axes.set(xlim=(0, size[0]), ylim=(0, size[1]))
            pdf.savefig(figure)
    return {"pages": count, "marks": len({mark.name for mark in marks})}


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
    """Draw one chart's window: its colours inside its border, the allowance around it, marks, and its name."""
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
    middle = np.array(at) + np.subtract(tile.high, tile.low) / 2
    write(axes, middle, chart.name + f", part {tile.part} of {tile.parts}" * bool(tile.part), 6)


def write(axes: Axes, at: Float[np.ndarray, " 2"], words: str, size: int, **more: object) -> Text:
    """Write a few words on white that lets the picture shine through."""
    box = {"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 0.5}
    return axes.text(*at.tolist(), words, fontsize=size, ha="center", va="center", bbox=box, zorder=4, **more)


def draw_colors(axes: Axes, layout: Layout, texture: Texture, tile: Tile, shift: Float[np.ndarray, " 2"]) -> None:
    """Draw the texture within a window, where this chart is."""
    from matplotlib.path import Path as Outline

    dots = texture.chart_rows / layout.size[1]
    x0, y0 = np.floor(np.array(tile.low) * dots).astype(int).clip(0)
    x1, y1 = np.ceil(np.array(tile.high) * dots).astype(int)
    y1, x1 = min(y1, texture.chart_rows), min(x1, texture.image.shape[1])
    crop = texture.image[texture.chart_rows - y1 : texture.chart_rows - y0, x0:x1]
    extent = np.array([x0, x1, y0, y1]) / dots + np.repeat(shift, 2)
    picture = axes.imshow(crop, extent=extent, interpolation="none", origin="upper", aspect="auto", zorder=2)
    # Neighbouring charts reach into the window: show only this one's triangles.
    triangles = layout.corners[layout.chart == tile.chart] + shift
    closed = np.concatenate([triangles, triangles[:, :1]], axis=1).reshape(-1, 2)
    codes = np.tile([Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY], len(triangles))
    picture.set_clip_path(Outline(closed, codes), axes.transData)


def draw_lines(axes: Axes, lines: Float[np.ndarray, "n 2 2"], frame: Patch, color: str, width: float) -> None:
    """Draw lines within a window; width in points."""
    from matplotlib.collections import LineCollection

    collection = LineCollection(lines, colors=color, linewidths=width, capstyle="round", zorder=1 if width > 1 else 3)
    axes.add_collection(collection)
    collection.set_clip_path(frame)  # afterwards: adding resets it


def draw_marks(axes: Axes, marks: list[Mark], shift: Float[np.ndarray, " 2"], frame: Patch, length: float) -> None:
    """Draw a tick from the seam outwards, and its name."""
    if not marks:
        return
    points = np.stack([mark.point for mark in marks]) + shift
    ends = points + length * np.stack([mark.outwards for mark in marks])
    draw_lines(axes, np.stack([points, ends], axis=1), frame, "black", 0.6)
    for mark, point in zip(marks, points, strict=True):
        text = write(axes, point - 0.003 * mark.outwards, mark.name, 4)
        text.set_clip_path(frame)
        text.set_clip_on(True)


def draw_glue_lines(axes: Axes, tile: Tile, parts: list[Tile], at: tuple[float, float]) -> None:
    """Draw dashed lines where another part's window ends within this one, its number beside: lay its edge there."""
    shift = np.subtract(at, tile.low)
    for other in parts:
        for axis in (0, 1):
            span = [max(tile.low[1 - axis], other.low[1 - axis]), min(tile.high[1 - axis], other.high[1 - axis])]
            for edge in (other.low[axis], other.high[axis]):
                if span[0] < span[1] and tile.low[axis] + 1e-6 < edge < tile.high[axis] - 1e-6:
                    ends = np.array([[edge, span[0]], [edge, span[1]]])[:, [axis, 1 - axis]] + shift
                    axes.plot(*ends.T, color="0.35", lw=0.4, dashes=(6, 4), zorder=3)
                    write(axes, ends.mean(axis=0), f"part {other.part}", 4, rotation=90 * (axis == 0))


def draw_foot(axes: Axes, text: str, bar: bool = True) -> None:
    """Draw a bar of 100 mm with marks every 10 mm, and a line of text."""
    axes.text(MARGIN, MARGIN + 0.006, text, fontsize=7)
    if not bar:
        return
    for mark in range(10):
        color = "black" if mark % 2 == 0 else "white"
        axes.fill_between([MARGIN + mark * 0.01, MARGIN + (mark + 1) * 0.01], MARGIN, MARGIN + 0.003, color=color)
    axes.plot(
        [MARGIN, MARGIN + 0.1, MARGIN + 0.1, MARGIN, MARGIN], MARGIN + np.array([0, 0, 3, 3, 0]) / 1e3, "k", lw=0.4
    )
    axes.text(MARGIN + 0.102, MARGIN, "100 mm", fontsize=6)


HEAD = 0.022
"""Metres of words above the picture."""


def draw_overview(
    axes: Axes,
    layout: Layout,
    texture: Texture,
    names: list[str],
    placed: list[list[tuple[Tile, float, float]]],
    page: str,
) -> None:
    """Draw the layout on one page: colours, a frame for each part with its page, and how to put it together."""
    from matplotlib.patches import Rectangle

    width, height = PAGES[page]
    room = np.array([width - 2 * MARGIN, height - 2 * MARGIN - FOOT - HEAD])
    scale = float((room / layout.size).min())
    low = np.array([MARGIN + (room[0] - layout.size[0] * scale) / 2, MARGIN + FOOT])
    x, y = low + np.array(layout.size) * scale
    picture = texture.image[: texture.chart_rows]
    step = max(1, picture.shape[0] // 1500)
    axes.imshow(picture[::step, ::step], extent=(low[0], x, low[1], y), interpolation="none", aspect="auto", zorder=1)
    for number, items in enumerate(placed, start=2):
        for tile, _, _ in items:
            start, size = low + np.array(tile.low) * scale, np.subtract(tile.high, tile.low) * scale
            axes.add_patch(Rectangle(tuple(start), *size, fill=False, edgecolor="black", linewidth=0.5, zorder=2))
            words = f"{names[tile.chart]}\n" * (tile.part < 2) + f"page {number}"
            words += f", part {tile.part}" * bool(tile.part)
            write(axes, start + size / 2, words, 5)
    count = sum(map(len, placed))
    facts = [
        f"{layout.chart_count} pieces in {count} parts, on {len(placed)} more pages; here 1 : {1 / scale:.1f}.",
        f"Print at 100 % and check the bar of 100 mm. Parts of a piece overlap by {1000 * OVERLAP:.0f} mm: lay the",
        "edge of the part that is named on its dashed line. Letters along borders meet when pieces are sewn.",
    ]
    for line, words in enumerate(facts):
        axes.text(MARGIN, height - MARGIN - 0.004 - 0.005 * line, words, fontsize=7)
