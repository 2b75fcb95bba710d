"""Decoded and resized images on disk, so that no run pays for the same photograph twice.

One file of raw bytes for each picture and size, named after the SHA-256 of the picture's own file; see
files/caching.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from cloak_core.files.caching import DiskCache

LIMIT_BYTES = 4 << 30
"""Of all files together."""


class DecodedImages:
    """The images in a folder, by key. folder None keeps none. Never raises: what cannot be kept is made anew."""

    def __init__(self, folder: Path | None, limit: int = LIMIT_BYTES) -> None:
        self._files = DiskCache(folder, ".rgb", limit, "decoded images")

    def get(self, key: str, height: int, width: int) -> UInt8[np.ndarray, "H W 3"] | None:
        """The image, mapped from its file; None where there is none, or a damaged one."""
        data = self._files.get(f"{key}-{height}x{width}")
        return None if data is None or len(data) != height * width * 3 else data.reshape(height, width, 3)

    def put(self, key: str, image: UInt8[np.ndarray, "H W 3"]) -> None:
        """Keep an image. A full or read-only disk ends the keeping, with a warning."""
        height, width = image.shape[:2]
        self._files.put(f"{key}-{height}x{width}", np.ascontiguousarray(image).tobytes())

    def trim(self) -> None:
        """Remove the least recently used images beyond the limit."""
        self._files.trim()
