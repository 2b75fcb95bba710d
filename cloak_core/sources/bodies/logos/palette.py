"""Palette files: the colours a printer, or a set of cloths, can show. Training and printing read the same ones.

A text file, one colour a line: three numbers in [0, 1] between commas or spaces, or #rrggbb; lines that start with
"# " or ";" are comments. GIMP palettes (.gpl: three bytes and a name a line) are read as well. All are sRGB.

And how different two colours look: CIEDE2000.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_text
from cloak_core.sources.bodies.meshes.mesh_file import to_linear

MAX_BYTES = 1 << 20
MAX_COLORS = 4096
TOLERANCE = 8 / 255
"""Differences up to this, in the largest channel, count as printable."""
# Of sRGB (IEC 61966-2-1): linear red, green and blue to XYZ, and the white (D65) they add up to.
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = TO_XYZ.sum(axis=1)
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


def lab(colors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Convert sRGB colours in [0, 1] to CIELAB (L 0 to 100; white D65)."""
    relative = to_linear(np.asarray(colors, np.float64)) @ TO_XYZ.T / WHITE
    bent = np.where(relative > (6 / 29) ** 3, np.cbrt(relative), relative * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = bent.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def de2000(first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Compute CIEDE2000 between colours in CIELAB, k = 1. Symmetric; about 1 is just visible.

    Sharma, Wu, Dalal, "The CIEDE2000 color-difference formula" (Color Research and Application 30, 2005), by the
    numbers of whose equations the steps go.
    """
    (l1, a1, b1), (l2, a2, b2) = np.asarray(first, np.float64).T, np.asarray(second, np.float64).T
    mean_c = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    g = 0.5 * (1 - _fading(mean_c))  # (4)
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))  # (7)
    grey = c1 * c2 == 0
    turn = (h2 - h1 + 180) % 360 - 180
    turn = np.where(np.abs(h2 - h1) == 180, h2 - h1, turn)
    dh = np.where(grey, 0, 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2))  # (10), (11)
    mean_l, mean_c = (l1 + l2) / 2, (c1 + c2) / 2
    far = np.abs(h1 - h2) > 180
    mean_h = np.where(grey, h1 + h2, (h1 + h2 + np.where(far, np.where(h1 + h2 < 360, 360, -360), 0)) / 2)  # (14)
    cos = [np.cos(np.radians(k * mean_h + shift)) for k, shift in ((1, -30), (2, 0), (3, 6), (4, -63))]
    t = 1 - 0.17 * cos[0] + 0.24 * cos[1] + 0.32 * cos[2] - 0.2 * cos[3]  # (15)
    s_l = 1 + 0.015 * (mean_l - 50) ** 2 / np.sqrt(20 + (mean_l - 50) ** 2)  # (18)
    s_c, s_h = 1 + 0.045 * mean_c, 1 + 0.015 * mean_c * t
    rotation = 60 * np.exp(-(((mean_h - 275) / 25) ** 2))  # twice (16)
    r = -2 * _fading(mean_c) * np.sin(np.radians(rotation))  # (17), (21)
    light, chroma, hue = (l2 - l1) / s_l, (c2 - c1) / s_c, dh / s_h
    return np.sqrt(np.maximum(light**2 + chroma**2 + hue**2 + r * chroma * hue, 0))


def _fading(chroma: np.ndarray) -> np.ndarray:
    return np.sqrt(chroma**7 / (chroma**7 + 25.0**7))


def mean_difference(first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "n 3"]) -> float:
    """Average CIEDE2000 between sRGB colours in [0, 1]."""
    return float(de2000(lab(first), lab(second)).mean())
