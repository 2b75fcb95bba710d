"""How different two colours look: CIEDE2000."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from cloak_core.sources.bodies.meshes.mesh_file import to_linear

# Of sRGB (IEC 61966-2-1): linear red, green and blue to XYZ, and the white (D65) they add up to.
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = TO_XYZ.sum(axis=1)


def lab(colors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Convert sRGB colours in [0, 1] to CIELAB (L 0 to 100; white D65)."""
    relative = to_linear(np.asarray(colors, np.float64)) @ TO_XYZ.T / WHITE
    bent = np.where(relative > (6 / 29) ** 3, np.cbrt(relative), relative * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = bent.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def de2000(one: Float[np.ndarray, "n 3"], other: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Compute CIEDE2000 between colours in CIELAB, k = 1. Symmetric; about 1 is just visible.

    Sharma, Wu, Dalal, "The CIEDE2000 color-difference formula" (Color Research and Application 30, 2005), by the
    numbers of whose equations the steps go.
    """
    (l1, a1, b1), (l2, a2, b2) = np.asarray(one, np.float64).T, np.asarray(other, np.float64).T
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


def mean_difference(one: Float[np.ndarray, "n 3"], other: Float[np.ndarray, "n 3"]) -> float:
    """Average CIEDE2000 between sRGB colours in [0, 1]."""
    return float(de2000(lab(one), lab(other)).mean())
