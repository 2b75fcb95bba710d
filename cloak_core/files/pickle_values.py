"""What a pickle's reader makes in the place of foreign objects, and what it checks of shapes and keys."""

from __future__ import annotations

import io
import re
from collections.abc import Callable

import numpy as np

MAX_AXES = 64
_PLAIN = (str, int, float, bytes, bool, type(None))
"""Types of dictionary keys: hashing nested tuples takes time exponential in their depth."""
_NUMBER = re.compile(r"[<>|=]?(b1|\?|[iu][1248]|f[248]|[SU][0-9]{1,4})\Z")


class Record:
    """What is left of an object of a class that is not imported: its class's name and its state."""

    def __init__(self) -> None:
        self.state: dict = {}


class DType:
    """The type of an array's numbers; its byte order may follow when it is given its state."""

    def __init__(self, code: object, *unused: object) -> None:
        code = code.decode("latin1") if isinstance(code, bytes) else code
        if not isinstance(code, str) or not _NUMBER.match(code):
            raise ValueError(f"an array of {str(code)[:20]!r}, which is no type of numbers")
        self.dtype = np.dtype(code)

    def set_state(self, state: object) -> None:
        """Of all that numpy records, the byte order alone counts."""
        order = state[1] if isinstance(state, tuple) and len(state) > 1 else None
        if order not in ("<", ">", "|", "="):
            raise ValueError("a type of numbers without a byte order")
        self.dtype = self.dtype.newbyteorder("<" if order == "=" else order)


class Sized:
    """A file from which never more is asked than it holds: a length in a pickle may be anything."""

    def __init__(self, file: io.BufferedIOBase) -> None:
        self.file, start = file, file.tell()
        self.size = file.seek(0, io.SEEK_END)
        file.seek(start)
        self.readline = file.readline

    def read(self, count: int) -> bytes:
        return self.file.read(min(count, self.size - self.file.tell()))


class Admitted:
    """A function that a pickle may call. `make` gets the machine, then the pickle's arguments: anything at all."""

    def __init__(self, make: Callable[..., object]) -> None:
        self.make = make


def count_of(shape: object) -> int:
    """How many numbers an array of this shape has. ValueError: no shape."""
    if not isinstance(shape, tuple) or len(shape) > MAX_AXES:
        raise ValueError("a shape that is none")
    count = 1
    for extent in shape:
        if type(extent) is not int or not 0 <= extent < 1 << 48:
            raise ValueError("a shape that is none")
        count *= extent
    return count


def plain_key(value: object) -> object:
    """The value, which a dictionary or set is to hold as a key. ValueError: slow to hash, or to compare."""
    if type(value) not in _PLAIN or (type(value) is int and not -(1 << 63) <= value < 1 << 64):
        raise ValueError(f"a {type(value).__name__} as a key")
    return value
