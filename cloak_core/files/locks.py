"""Locks between processes."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

from .errors import InputError
from .writing import open_to_append, try_lock


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
