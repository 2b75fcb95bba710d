"""Decoded and resized images on disk, so that no run pays for the same photograph twice.

One file for each picture and size, named after the SHA-256 of the picture's own file: raw bytes, then their CRC-32. It
is written under another name and renamed, so that processes may share the folder and a crash leaves nothing half; what
is torn nevertheless fails its checksum and is made anew. `CLOAK_CACHE` names the folder ("off": none); without it, it
is `cloak` in the user's cache folder.
"""

from __future__ import annotations

import contextlib
import logging
import os
import tempfile
import zlib
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

LIMIT_BYTES = 4 << 30
"""Of all files together; the least recently written go first."""
_CHECKSUM = 4
_SUFFIX = ".rgb"
_log = logging.getLogger("cloak")


def cache_folder() -> Path | None:
    """Where decoded images are kept; None: nowhere."""
    named = os.environ.get("CLOAK_CACHE", "")
    if named.lower() == "off":
        return None
    if named:
        return Path(named) / "images"
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    return Path(home) / "cloak" / "images"


class DecodedImages:
    """The images in a folder, by key. folder None keeps none. Never raises: what cannot be kept is made anew."""

    def __init__(self, folder: Path | None, limit: int = LIMIT_BYTES) -> None:
        self._folder, self._limit = folder, limit
        self._written = 0

    def get(self, key: str, height: int, width: int) -> UInt8[np.ndarray, "H W 3"] | None:
        """The image, mapped from its file; None where there is none, or a damaged one."""
        if self._folder is None:
            return None
        size = height * width * 3
        try:
            path = self._path(key, height, width)
            if path.stat().st_size != size + _CHECKSUM:
                return None
            # Mapped copy-on-write: torch takes no read-only arrays, and nothing reaches the file.
            data = np.memmap(path, np.uint8, "c")
        except (OSError, ValueError):
            return None
        if zlib.crc32(data[:size]) != int.from_bytes(data[size:].tobytes(), "little"):
            return None
        return np.asarray(data[:size]).reshape(height, width, 3)

    def put(self, key: str, image: UInt8[np.ndarray, "H W 3"]) -> None:
        """Keep an image. A full or read-only disk ends the keeping, with a warning."""
        if self._folder is None:
            return
        data = np.ascontiguousarray(image).tobytes()
        path = self._path(key, *image.shape[:2])
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(prefix=".new-", dir=path.parent)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(data + zlib.crc32(data).to_bytes(_CHECKSUM, "little"))
                os.replace(name, path)
            except BaseException:
                with contextlib.suppress(OSError):
                    os.unlink(name)
                raise
        except OSError as error:
            _log.warning("%s: decoded images are not kept (%s)", self._folder, error.strerror or error)
            self._folder = None
            return
        self._written += len(data)
        if self._written > self._limit // 8:
            self.trim()

    def trim(self) -> None:
        """Remove the oldest files beyond the limit, and what killed processes left."""
        if self._folder is None:
            return
        self._written = 0
        found = []
        for path in self._folder.glob("*"):
            with contextlib.suppress(OSError):  # another process may have removed it
                found.append((path.stat().st_mtime, path.stat().st_size, path))
        total = 0
        for _, size, path in sorted(found, reverse=True):
            total += size
            if total > self._limit:
                with contextlib.suppress(OSError):
                    path.unlink()

    def _path(self, key: str, height: int, width: int) -> Path:
        return self._folder / f"{key}-{height}x{width}{_SUFFIX}"
