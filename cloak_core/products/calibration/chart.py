"""The chart: patches of known colours between four marks, on one sheet of A4."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from cloak_core.files.errors import InputError
from cloak_core.files.writing import replace_file, write_text
from cloak_core.products.print_sheets import draw_foot
from cloak_core.products.tiling import PAGES

COLUMNS, ROWS = 16, 22
LEVELS = 7
"""Of each channel: 343 patches; greys fill the sheet."""
LOW, HIGH = (0.015, 0.049), (0.195, 0.271)
"""Metres: the corners of the field of patches, from the sheet's lower left one."""
FILLED = 0.8
"""Share of its cell's width and height that a patch fills; the rest is paper, by which uneven light is seen."""
MARK = 0.014
MARKS = np.array([[0.022, 0.038], [0.188, 0.038], [0.188, 0.282], [0.022, 0.282]])
"""Centres of the marks, metres, counter-clockwise: black squares with a white ring, 3 : 5 : 7 as in QR codes."""


def patch_colors() -> Float[np.ndarray, "352 3"]:
    """List the patches' colours as they are sent, sRGB in [0, 1], row by row from the upper left one.

    In mixed order, so that light that falls off over the sheet looks like no colour.
    """
    steps = np.linspace(0, 1, LEVELS)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    greys = np.linspace(0, 1, COLUMNS * ROWS - len(grid) + 2)[1:-1, None].repeat(3, axis=1)
    colors = np.concatenate([grid, greys])
    colors = colors[np.random.default_rng(2000).permutation(len(colors))]
    return np.round(colors * 255) / 255


def patch_centres() -> Float[np.ndarray, "352 2"]:
    """Locate the patches, metres from the sheet's lower left corner, in the order of `patch_colors`."""
    return _lattice((np.arange(COLUMNS) + 0.5) / COLUMNS, 1 - (np.arange(ROWS) + 0.5) / ROWS)


def paper_spots() -> Float[np.ndarray, "315 2"]:
    """Locate the bare paper between each four patches, metres."""
    return _lattice(np.arange(1, COLUMNS) / COLUMNS, 1 - np.arange(1, ROWS) / ROWS)


def patch_size() -> Float[np.ndarray, " 2"]:
    """Give width and height of a patch, metres."""
    return np.subtract(HIGH, LOW) / (COLUMNS, ROWS) * FILLED


def _lattice(across: np.ndarray, up: np.ndarray) -> np.ndarray:
    y, x = np.meshgrid(up, across, indexing="ij")
    return np.array(LOW) + np.stack([x, y], axis=-1).reshape(-1, 2) * np.subtract(HIGH, LOW)


def write_chart(path: Path, dpi: int = 300) -> None:
    """Write the chart as a PDF (or a .png, `dpi` pixels per inch), and beside it a CSV of what each patch sends,
    for those who measure patches one by one. InputError: another kind of file."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("pdf", "png"):
        raise InputError(f"--chart {path}: a .pdf or a .png")
    size = PAGES["A4"]
    figure = Figure(figsize=(size[0] / 0.0254, size[1] / 0.0254), dpi=dpi, facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.axis("off")
    extent = patch_size()
    for centre, color in zip(patch_centres(), patch_colors(), strict=True):
        axes.add_patch(Rectangle(centre - extent / 2, *extent, color=tuple(color), linewidth=0))
    for mark in MARKS:
        for scale, color in ((1, "black"), (5 / 7, "white"), (3 / 7, "black")):
            side = MARK * scale
            axes.add_patch(Rectangle(mark - side / 2, side, side, color=color, linewidth=0))
    draw_foot(
        axes, "cloak calibrate: print as the sheets will be printed, then photograph flat, all four marks in view"
    )
    axes.set(xlim=(0, size[0]), ylim=(0, size[1]))
    made = {"Creator": "cloak", "Producer": None, "CreationDate": None} if kind == "pdf" else {"Software": "cloak"}
    replace_file(path, lambda file: figure.savefig(file, format=kind, metadata=made))
    write_text(path.with_suffix(".csv"), chart_table())


def chart_table() -> str:
    """Write what each patch sends, as CSV; measured values go into the empty columns."""
    lines = ["row,column,sent_r,sent_g,sent_b,seen_r,seen_g,seen_b"]
    for number, color in enumerate(np.round(patch_colors() * 255).astype(int).tolist()):
        row, column = divmod(number, COLUMNS)
        lines.append(f"{row + 1},{column + 1},{','.join(map(str, color))},,,")
    return "\n".join(lines) + "\n"
