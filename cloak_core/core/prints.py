"""Plain prints of our own, which nobody trained: beginnings of a cloth, and controls beside one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8

from cloak_core.files.errors import InputError

PRINT_METRES = 0.25
"""Width and height of the piece that repeats."""
PIXELS = 250
"""Of that piece, as a picture: 1 mm each."""


@dataclass(frozen=True, kw_only=True)
class Print:
    """Rows of one shape on a background; piece of cloth, `PRINT_METRES` wide and high, that repeats."""

    shape: Literal["ellipse", "check", "stripe", "person"]
    """An ellipse, a filled cell of a chessboard, a bar across the whole piece, or a person's head and trunk."""
    columns: int = 1
    rows: int = 2
    """Of cells, each with a shape in its middle; every second row is moved by half a cell, as bricks lie."""
    width: float = 0.08
    height: float = 0.10
    """Of an ellipse or a bar, metres."""
    colors: tuple[tuple[float, float, float], ...]
    """sRGB in [0, 1]; row i, or person i of a crowd, has colour i modulo their number."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shade: float = 0.0
    """Ellipses and trunks are lit from above: their lower edges are darker than their colour by up to this share."""

    def at(self, places: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 3"]:
        """Find the colours at places on the cloth, metres right and down."""
        cells = places / PRINT_METRES * (self.columns, self.rows)
        if self.shape == "person":
            return self._crowd(cells)
        row = np.floor(cells[:, 1]).astype(int) % self.rows
        across = cells[:, 0] + 0.5 * (row % 2)
        right = (across % 1 - 0.5) * PRINT_METRES / self.columns
        down = (cells[:, 1] % 1 - 0.5) * PRINT_METRES / self.rows
        if self.shape == "ellipse":
            inside = (2 * right / self.width) ** 2 + (2 * down / self.height) ** 2 < 1
        elif self.shape == "check":
            inside = right < 0
        else:
            inside = abs(down) < self.height / 2
        light = 1 - self.shade * np.clip(0.5 + down / self.height, 0, 1)
        shapes = np.array(self.colors)[row % len(self.colors)] * light[:, None]
        return np.where(inside[:, None], shapes, self.background).astype(np.float32)

    def _crowd(self, cells: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 3"]:
        """Draw rows of people, the lower in front of the upper. People are as large as cells are wide."""
        colors = np.tile(np.array(self.background), (len(cells), 1))
        # Trunks reach down here from two rows above, heads up from the row below.
        for behind in (2, 1, 0, -1):
            row = np.floor(cells[:, 1]).astype(int) - behind
            across = cells[:, 0] + 0.5 * (row % self.rows % 2)
            person = row % self.rows * self.columns + np.floor(across).astype(int) % self.columns
            right = across % 1 - 0.5  # in a cell's widths, as what follows
            down = (cells[:, 1] - row - 0.4) * self.columns / self.rows  # from the shoulders
            light = 1 - self.shade * np.clip(down / 1.2, 0, 1)
            trunk = np.array(self.colors)[person % len(self.colors)] * light[:, None]
            face = np.array(SKINS)[person % len(SKINS)]
            half = 0.48 * np.sqrt(np.clip(1 - (1 - np.clip(down / 0.3, 0, 1)) ** 2, 0, 1))
            for inside, color in (
                ((down > 0) & (abs(right) < half), trunk),
                ((right / 0.3) ** 2 + ((down + 0.18) / 0.32) ** 2 < 1, 0.25 * face),  # hair
                ((right / 0.23) ** 2 + ((down + 0.12) / 0.25) ** 2 < 1, face),
            ):
                colors = np.where(inside[:, None], color, colors)
        return colors.astype(np.float32)


SKINS = ((0.98, 0.84, 0.71), (0.92, 0.74, 0.59), (0.55, 0.35, 0.24), (0.98, 0.84, 0.71), (0.78, 0.55, 0.39))
"""Of the people of a crowd, sRGB in [0, 1]."""
ROSE, LIME, WHITE = (0.95, 0.55, 0.6), (0.75, 0.9, 0.3), (1.0, 1.0, 1.0)
BLUE, SAND = (0.24, 0.43, 0.94), (0.8, 0.7, 0.6)
PRINTS: dict[str, Print] = {
    "balls": Print(shape="ellipse", columns=3, rows=3, width=0.08, height=0.08, colors=(LIME,), shade=0.8),
    "ellipses": Print(shape="ellipse", columns=3, colors=(ROSE, LIME), shade=0.5),
    "dots": Print(shape="ellipse", columns=3, rows=4, width=0.04, height=0.04, colors=(WHITE,)),
    "checks": Print(shape="check", columns=2, rows=4, colors=(WHITE,)),
    "crowd": Print(
        shape="person", columns=3, rows=3, colors=3 * (WHITE,) + 3 * (LIME,) + (WHITE, BLUE, SAND), shade=1.0
    ),
    "stripes": Print(shape="stripe", rows=4, height=0.03, colors=(WHITE,)),
}
"""By the names that `--initial` and `print:NAME` take."""


def print_picture(name: str) -> UInt8[np.ndarray, "side side 3"]:
    """Draw the piece of a print that repeats, row 0 at the top. InputError: no such print."""
    if name not in PRINTS:
        raise InputError(f"print:{name}: no such print (known: {', '.join(PRINTS)})")
    row, column = np.divmod(np.arange(PIXELS**2), PIXELS)
    places = (np.stack([column, row], axis=1) + 0.5) * PRINT_METRES / PIXELS
    return np.round(255 * PRINTS[name].at(places)).astype(np.uint8).reshape(PIXELS, PIXELS, 3)
