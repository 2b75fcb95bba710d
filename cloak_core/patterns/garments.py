"""The colours of a garment on the faces of a logo: plain, an outfit's, camouflage, or a picture as cloth."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8
from scipy.ndimage import gaussian_filter

from cloak_core.core.logo import Logo
from cloak_core.core.pictures import read_picture
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.patterns.cloth import ClothPattern

TILE = 0.5
"""Metres that a picture repeats after, unless told."""
PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp")
WOODLAND = np.array([(75, 83, 52), (44, 53, 36), (98, 80, 56), (151, 138, 101)], np.uint8)
"""Olive, dark green, brown, tan."""
_PLAIN = re.compile(r"#([0-9a-fA-F]{6})")


def garment_colors(spec: str, bodies: Bodies, logo: Logo) -> Float32[np.ndarray, "L 3"] | None:
    """Find a garment's colours on the logo, sRGB in [0, 1]; None where `spec` names neither of these.

    spec: "#rrggbb"; "clothing", the body's first outfit; "camouflage", a woodland print; a picture,
    FILE.png[@tile=METRES], worn as cloth: each face has its mean there. InputError: no such picture, no width.
    """
    if (plain := _PLAIN.fullmatch(spec)) is not None:
        color = np.frombuffer(bytes.fromhex(plain[1]), np.uint8) / np.float32(255)
        return np.tile(color.astype(np.float32), (len(logo), 1))
    if spec == "clothing":
        return np.ascontiguousarray(bodies.face_colors[0, logo.face_ids], np.float32)
    file, _, width = spec.partition("@tile=")
    if spec != "camouflage" and Path(file).suffix.lower() not in PICTURES:
        return None
    try:
        tile = float(width or TILE)
    except ValueError:
        tile = 0.0
    if not 0.01 <= tile <= 10:
        raise InputError(f"{spec}: tile={width} is no width in metres (0.01 to 10)")
    picture = camouflage() if spec == "camouflage" else read_picture(Path(file).expanduser())
    cloth = ClothPattern.of_picture(logo, picture, tile, bodies=bodies)
    return cloth.on_faces(cloth.colors)


def camouflage(side: int = 256) -> UInt8[np.ndarray, "side side 3"]:
    """Draw a woodland print that repeats: smooth noise, cut at its quantiles into four colours."""
    noise = gaussian_filter(np.random.default_rng(0).standard_normal((side, side)), side / 24, mode="wrap")
    return WOODLAND[np.searchsorted(np.quantile(noise, (0.3, 0.6, 0.8)), noise)]
