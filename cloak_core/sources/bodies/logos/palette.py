"""Palette files: the colours a printer, or a set of cloths, can show. Training and printing read the same ones.

A text file, one colour a line: three numbers in [0, 1] between commas or spaces, or #rrggbb; lines that start with
"# " or ";" are comments. GIMP palettes (.gpl: three bytes and a name a line) are read as well. All are sRGB.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_text

MAX_BYTES = 1 << 20
MAX_COLORS = 4096
TOLERANCE = 8 / 255
"""Differences up to this, in the largest channel, count as printable."""
_HEX = re.compile(r"#([0-9a-fA-F]{6})\b")


def read_palette(path: str | os.PathLike) -> Float[np.ndarray, "P 3"]:
    """Read the colours of a palette file, sRGB in [0, 1], float64. InputError names the file and line."""
    path = Path(path)
    lines = read_text(path, MAX_BYTES).removeprefix("\ufeff").splitlines()
    gimp = bool(lines) and lines[0].strip() == "GIMP Palette"
    colors = []
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if gimp:
            is_aside = number == 1 or text.startswith("#") or text.partition(":")[0] in ("Name", "Columns")
        else:
            is_aside = text == "#" or text.startswith(("# ", ";"))
        if text and not is_aside:
            colors.append(_color(text, gimp, f"{path}:{number}"))
    if not colors:
        raise InputError(f"{path}: no colour in this palette")
    if len(colors) > MAX_COLORS:
        raise InputError(f"{path}: {len(colors)} colours, more than {MAX_COLORS}")
    return np.array(colors, np.float64)


def nearest_in_palette(
    colors: Float[np.ndarray, "n 3"], palette: Float[np.ndarray, "P 3"]
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Find each colour's nearest of the palette; tell whether it is farther than `TOLERANCE` from it."""
    square = (palette**2).sum(axis=1)
    nearest = np.empty((len(colors), 3))
    for start in range(0, len(colors), 256):
        part = colors[start : start + 256].astype(np.float64)
        nearest[start : start + 256] = palette[(square - 2 * part @ palette.T).argmin(axis=1)]
    return nearest, np.abs(nearest - colors).max(axis=1, initial=0) > TOLERANCE


def _color(text: str, gimp: bool, place: str) -> tuple[float, float, float]:
    if not gimp and (match := _HEX.match(text)):
        return tuple(byte / 255 for byte in bytes.fromhex(match[1]))
    parts = text.split()[:3] if gimp else text.replace(",", " ").split()
    try:
        values = tuple(float(part) / (255 if gimp else 1) for part in parts)
    except ValueError:
        values = ()
    if len(values) != 3 or not all(0 <= value <= 1 for value in values):
        expected = "three bytes" if gimp else "three numbers in [0, 1], or #rrggbb"
        raise InputError(f"{place}: {text[:40]!r} is no colour ({expected})")
    return values
