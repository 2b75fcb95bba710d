"""The first page of the sheets: all pieces, small, with their names, and the page that each part is on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cloak_core.output.baking import Texture
from cloak_core.output.layout import Layout
from cloak_core.output.tiling import FOOT, MARGIN, OVERLAP, PAGES, Tile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    box = {"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 0.6}
    for number, items in enumerate(placed, start=2):
        for tile, _, _ in items:
            start, size = low + np.array(tile.low) * scale, np.subtract(tile.high, tile.low) * scale
            axes.add_patch(Rectangle(tuple(start), *size, fill=False, edgecolor="black", linewidth=0.5, zorder=2))
            words = f"{names[tile.chart]}\n" * (tile.part < 2) + f"page {number}"
            words += f", part {tile.part}" * bool(tile.part)
            axes.text(*(start + size / 2), words, fontsize=5, ha="center", va="center", bbox=box, zorder=3)
    count = sum(map(len, placed))
    told = [
        f"{layout.chart_count} pieces in {count} parts, on {len(placed)} more pages; here 1 : {1 / scale:.1f}.",
        f"Print at 100 % and check the bar of 100 mm. Parts of a piece overlap by {1000 * OVERLAP:.0f} mm: lay the",
        "edge of the part that is named on its dashed line. Letters along borders meet when pieces are sewn.",
    ]
    for line, words in enumerate(told):
        axes.text(MARGIN, height - MARGIN - 0.004 - 0.005 * line, words, fontsize=7)
