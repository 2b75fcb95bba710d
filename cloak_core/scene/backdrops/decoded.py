"""Decoded and resized images on disk, so that no run pays for the same photograph twice.

One file of raw bytes for each picture and size, named after the SHA-256 of the picture's own file and what decodes it,
and one of what the picture is; see files/caching.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from cloak_core.files.caching import DiskCache
from cloak_core.files.identity import code_hash, package_versions, sha256_record

LIMIT_BYTES = 4 << 30
"""Of all files together."""
IDENTITIES_BYTES = 64 << 20


class Picture(NamedTuple):
    """What a picture is, wherever and however it is stored."""

    pixels: str
    """SHA-256 (hex) of its decoded pixels, upright and at full size; of a picture that is drawn, its name."""
    look: str = ""
    """See `files.likeness.picture_look`; "" where nobody looked."""
    file: str = ""
    """SHA-256 (hex) of its file."""


class DecodedImages:
    """The images in a folder, by key. folder None keeps none. Never raises: what cannot be kept is made anew."""

    def __init__(self, folder: Path | None, limit: int = LIMIT_BYTES) -> None:
        self._files = DiskCache(folder, ".rgb", limit, "decoded images")
        self._pictures = DiskCache(folder, ".picture", IDENTITIES_BYTES, "identities of images")
        decoder = [
            code_hash("scene/backdrops/backgrounds.py", "files/likeness.py", "files/crops.py"),
            package_versions("pillow"),
        ]
        self._decoder = sha256_record(decoder)[:8]

    def get(self, key: str, height: int, width: int) -> UInt8[np.ndarray, "H W 3"] | None:
        """Map the image from its file; None where there is none, or a damaged one."""
        data = self._files.get(f"{key}-{height}x{width}-{self._decoder}")
        return None if data is None or len(data) != height * width * 3 else data.reshape(height, width, 3)

    def put(self, key: str, image: UInt8[np.ndarray, "H W 3"]) -> None:
        """Keep an image. A full or read-only disk ends the keeping, with a warning."""
        height, width = image.shape[:2]
        self._files.put(f"{key}-{height}x{width}-{self._decoder}", np.ascontiguousarray(image).tobytes())

    def picture(self, key: str) -> Picture | None:
        """Tell what the picture with this key is; None where that is not known yet."""
        data = self._pictures.get(f"{key}-{self._decoder}")
        pixels, comma, look = ("" if data is None else data.tobytes().decode("ascii", "replace")).partition(",")
        return Picture(pixels, look, key) if comma else None

    def put_picture(self, picture: Picture) -> None:
        """Keep what a picture is."""
        self._pictures.put(f"{picture.file}-{self._decoder}", f"{picture.pixels},{picture.look}".encode())
