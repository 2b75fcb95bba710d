"""Two bounded caches: one in memory, one of files that save work between runs.

The files are found again by the hash of what they were made from. A file is its data, then their CRC-32. It is written
under another name and renamed, so that processes may share the folder and a crash leaves nothing half; what is torn
nevertheless fails its checksum and is made anew. `CLOAK_CACHE` names the folder ("off": none); without it, it is
`cloak` in the user's cache folder.
"""

from __future__ import annotations

import contextlib
import logging
import os
import tempfile
import threading
import zlib
from collections import OrderedDict
from collections.abc import Hashable
from pathlib import Path

import numpy as np

from .reading import open_regular, read_ahead

_CHECKSUM = 4
_NEW = ".new-"
_log = logging.getLogger("cloak")


def cache_folder(kind: str) -> Path | None:
    """Where files of one kind ("images", "views") are kept; None: nowhere."""
    named = os.environ.get("CLOAK_CACHE", "")
    if named.lower() == "off":
        return None
    if named:
        return Path(named) / kind
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    return Path(home) / "cloak" / kind


class DiskCache:
    """The files of one kind in a folder, by name. Never raises: what cannot be kept is made anew.

    folder: None keeps none. suffix: of their names; what else lies in the folder is left alone. limit: bytes of all
    together; the least recently used go first. what: names them in a warning.
    """

    def __init__(self, folder: Path | None, suffix: str, limit: int, what: str) -> None:
        self._folder, self._suffix, self._limit, self._what = folder, suffix, limit, what
        self._written = limit  # what earlier runs left counts from the first file on

    def get(self, name: str) -> np.ndarray | None:
        """The data [N] uint8, mapped from the file; None where there is none, or a damaged one."""
        if self._folder is None:
            return None
        path = self._path(name)
        try:
            with open_regular(path) as file:
                # Mapped copy-on-write: torch takes no read-only arrays, and nothing reaches the file.
                data = np.memmap(file, np.uint8, "c")
        except ValueError:  # not there (`InputError`), or empty
            return None
        if len(data) <= _CHECKSUM:  # no data has this checksum, too: four zeros
            return None
        if zlib.crc32(data[:-_CHECKSUM]) != int.from_bytes(data[-_CHECKSUM:].tobytes(), "little"):
            return None
        with contextlib.suppress(OSError):
            os.utime(path)
        return np.asarray(data[:-_CHECKSUM])

    def put(self, name: str, data: bytes) -> bool:
        """Keep some data, and tell whether it is kept. A full or read-only disk ends the keeping, with a warning."""
        if self._folder is None:
            return False
        path = self._path(name)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, new = tempfile.mkstemp(prefix=_NEW, dir=path.parent)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(data)
                    file.write(zlib.crc32(data).to_bytes(_CHECKSUM, "little"))
                os.replace(new, path)
            except BaseException:
                with contextlib.suppress(OSError):
                    os.unlink(new)
                raise
        except OSError as error:
            _log.warning("%s: %s are not kept (%s)", self._folder, self._what, error.strerror or error)
            self._folder = None
            return False
        self._written += len(data)
        if self._written > self._limit // 8:
            self.trim()
        return True

    def expect(self, name: str) -> None:
        """Have the system read a file's data ahead of need."""
        if self._folder is not None:
            read_ahead(self._path(name))

    def trim(self) -> None:
        """Remove the least recently used files beyond the limit, and what killed processes left among them."""
        if self._folder is None:
            return
        self._written = 0
        entries = []
        for pattern in (f"*{self._suffix}", f"{_NEW}*"):
            for path in self._folder.glob(pattern):
                with contextlib.suppress(OSError):  # another process may have removed it
                    entries.append((path.stat().st_mtime, path.stat().st_size, path))
        total = 0
        for _, size, path in sorted(entries, reverse=True):
            total += size
            if total > self._limit:
                with contextlib.suppress(OSError):
                    path.unlink()

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}{self._suffix}"


class MemoryCache:
    """Objects by key, the least recently used dropped first once what they hold exceeds a number of bytes.

    Threads may share one. The newest object stays even if it is larger than the limit. `bytes` is what the memory
    behind all of them takes: what several objects share counts once, and a view holds all that it is a view of.
    """

    def __init__(self, limit: int) -> None:
        self.limit, self.bytes = limit, 0
        self._items: OrderedDict[Hashable, tuple[object, dict[int, int]]] = OrderedDict()
        self._memory: dict[int, list[int]] = {}  # address -> how many items hold it, its bytes
        self._lock = threading.Lock()

    def get(self, key: Hashable) -> object | None:
        """What was put there, now the most recently used; None where there is nothing."""
        with self._lock:
            if key not in self._items:
                return None
            self._items.move_to_end(key)
            return self._items[key][0]

    def put(self, key: Hashable, item: object) -> object:
        """Keep an object in place of an earlier one of that key, and return it."""
        held = storages(item)
        with self._lock:
            if key in self._items:
                self._drop(key)
            self._items[key] = (item, held)
            for address, size in held.items():
                if address not in self._memory:
                    self._memory[address] = [0, size]
                    self.bytes += size
                self._memory[address][0] += 1
            while self.bytes > self.limit and len(self._items) > 1:
                self._drop(next(iter(self._items)))
        return item

    def _drop(self, key: Hashable) -> None:
        for address in self._items.pop(key)[1]:
            memory = self._memory[address]
            memory[0] -= 1
            if not memory[0]:
                self.bytes -= self._memory.pop(address)[1]


def storages(item: object) -> dict[int, int]:
    """The memory behind arrays and (torch) tensors, address -> bytes: of one, of those in a list, tuple or dictionary,
    or of those among an object's attributes, and theirs."""
    if hasattr(item, "untyped_storage"):
        storage = item.untyped_storage()
        return {storage.data_ptr(): storage.nbytes()}
    if isinstance(item, np.ndarray):
        while isinstance(item.base, np.ndarray):
            item = item.base
        return {item.ctypes.data: item.nbytes}
    parts = item if isinstance(item, (list, tuple)) else item.values() if isinstance(item, dict) else []
    tensors = {}
    for part in (*parts, *getattr(item, "__dict__", {}).values()):
        tensors |= storages(part)
    return tensors
