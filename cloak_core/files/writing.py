"""Writing files that appear whole or not at all, whatever happens in between; locks between processes."""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .errors import InputError

WRITING = ".writing"
"""A file in a folder that is being written; its process holds its lock."""
DAY = 24 * 3600.0


def write_json(path: str | os.PathLike, record: dict) -> None:
    """Replace a JSON file atomically."""
    text = json.dumps(record, indent=2, allow_nan=False) + "\n"
    write_bytes(path, text.encode())


def write_npy(path: str | os.PathLike, array: np.ndarray) -> None:
    """Replace a .npy file atomically."""
    replace_file(path, lambda file: np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False))


def write_bytes(path: str | os.PathLike, data: bytes) -> None:
    """Replace a file atomically."""
    replace_file(path, lambda file: file.write(data))


def write_text(path: str | os.PathLike, text: str) -> None:
    """Replace a UTF-8 file atomically. What UTF-8 lacks (a path of other bytes) is written as an escape."""
    write_bytes(path, text.encode(errors="backslashreplace"))


def write_npz(path: str | os.PathLike, compressed: bool = False, **arrays: np.ndarray) -> None:
    """Replace a .npz file atomically."""
    save = np.savez_compressed if compressed else np.savez
    replace_file(path, lambda file: save(file, **arrays))


def replace_file(path: str | os.PathLike, write: Callable[[BinaryIO], object]) -> None:
    """Write beside the file and rename over it: after a crash there is the old file or the new one, never a half.

    InputError: it cannot be written, or something other than a file (a folder, a device) has that name.
    """
    path = Path(path)
    with written(path):
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: not a regular file, and is left alone")
        temporary = _beside(path)
        try:
            with open(temporary, "xb") as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        finally:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(temporary)


def _beside(path: Path) -> Path:
    """Name what is being written. The system makes it with the permissions of the user's umask, as any file."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}")


def is_taken(path: str | os.PathLike) -> bool:
    """Tell whether something is there that a new file or folder would replace; an empty folder is not."""
    path = Path(path)
    return path.exists() and not (path.is_dir() and not path.is_symlink() and not any(path.iterdir()))


def require_new(path: str | os.PathLike) -> None:
    """Refuse an output that is there already: nothing is overwritten unasked. InputError: `is_taken`."""
    if is_taken(path):
        raise InputError(f"{path}: exists already")


def _leftovers(folder: Path, name: str = ".+") -> list[Path]:
    """List what killed writers left in a folder, of files and folders of this name (a regular expression)."""
    there = folder.iterdir() if folder.is_dir() else ()
    return [other for other in there if re.fullmatch(rf"\.{name}\.[a-z0-9_]{{8}}", other.name)]


def remove_leftovers(path: str | os.PathLike) -> None:
    """Remove what writers of this file or folder left beside it when they were killed. Nobody may be writing it now."""
    path = Path(path)
    for other in _leftovers(path.parent, re.escape(path.name)):
        shutil.rmtree(other, ignore_errors=True) if other.is_dir() else other.unlink(missing_ok=True)


def remove_all_leftovers(folder: Path) -> None:
    """Remove what killed writers left of any file in a folder. Nobody else may be writing into it now."""
    for other in _leftovers(folder):
        if other.is_file():
            with contextlib.suppress(OSError):  # it is in nobody's way
                other.unlink()


def open_to_append(path: str | os.PathLike) -> BinaryIO:
    """A regular file, made where there is none, to write at its end, unbuffered. InputError where that cannot be."""
    with written(path):
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        handle = os.open(path, flags, 0o666)
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            os.close(handle)
            raise InputError(f"{path}: not a regular file")
        return os.fdopen(handle, "ab", buffering=0)


def try_lock(handle: int, path: Path) -> bool:
    """Take the lock of an open file if nobody has it; tell whether it is ours. InputError: the file system has none."""
    if os.name == "nt":
        import msvcrt

        with contextlib.suppress(OSError):
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
            return True
        return False
    import fcntl

    with written(path), contextlib.suppress(BlockingIOError):
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False


@contextlib.contextmanager
def lock(path: Path, wait: bool = False, busy: str = "") -> Iterator[None]:
    """Hold the lock file `path`, which the system releases when the process ends, however it ends.

    BlockingIOError: somebody else holds it (without `wait`). InputError: it cannot be made; with `busy`, which says
    who else there may be, also that it is held.
    """
    with open_to_append(path) as file:
        while not try_lock(file.fileno(), path):
            if busy:
                raise InputError(busy)
            if not wait:
                raise BlockingIOError(f"{path}: held by another process")
            time.sleep(0.05)
        yield


def is_held(path: Path) -> bool:
    """Whether another process holds the lock file `path`; False where there is none, or none that could be asked.

    To ask is to take it for a moment: a process that wants it in that very moment finds it held.
    """
    if not path.is_file():
        return False
    try:
        with lock(path):
            return False
    except BlockingIOError:
        return True
    except InputError:
        return False


@contextlib.contextmanager
def written(path: str | os.PathLike) -> Iterator[None]:
    """Whatever the system has against writing becomes an `InputError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None


@contextlib.contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `folder` that takes its name when the block ends well and vanishes when not.

    What killed processes left of the same folder is removed.
    """
    with written(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        for other in _leftovers(folder.parent, re.escape(folder.name)):
            if other.is_dir() and _is_abandoned(other):
                shutil.rmtree(other, ignore_errors=True)
        temporary = _beside(folder)
        temporary.mkdir()
        try:
            with open_to_append(temporary / WRITING) as mark:
                with contextlib.suppress(InputError):  # no locks here: what is left then goes by its age
                    try_lock(mark.fileno(), temporary)
                yield temporary
            os.unlink(temporary / WRITING)
            if folder.exists():
                folder.rmdir()  # empty, or this fails; Windows cannot rename over a folder
            os.replace(temporary, folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _is_abandoned(temporary: Path) -> bool:
    """Tell whether the process that wrote a temporary folder was killed: a living one holds the lock of its mark.

    One without a mark (of an earlier version) goes after a day.
    """
    try:
        if not (temporary / WRITING).is_file():
            return time.time() - temporary.stat().st_mtime > DAY
        with open_to_append(temporary / WRITING) as mark:
            return try_lock(mark.fileno(), temporary)
    except (OSError, InputError):  # its process has just renamed it, or there are no locks
        return False
