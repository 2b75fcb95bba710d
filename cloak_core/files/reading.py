"""Reading files that anyone may have made: regular ones of bounded size, in one line that names the file when not.

Nothing is unpickled, and sizes are checked before memory is taken.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import stat
import tokenize
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .errors import InputError, first_line

MAX_BYTES = 2 << 30
"""No file is read that would take more memory than this."""
MAX_JSON_BYTES = 16 << 20
MAX_TOML_BYTES = 1 << 20
MAX_HEADER_BYTES = 64 << 10
"""Of a .npy file."""


@contextlib.contextmanager
def open_regular(path: str | os.PathLike, limit: int = MAX_BYTES) -> Iterator[BinaryIO]:
    """A regular file of at most `limit` bytes, open for reading; what the system has against it is an `InputError`.

    A named pipe, device, socket or folder is refused at once: it is never waited for.
    """
    path = Path(path)
    try:
        # Opening a named pipe waits for somebody to write into it unless told not to.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or first_line(error)}") from None
    with os.fdopen(handle, "rb") as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise InputError(f"{path}: {'a folder' if stat.S_ISDIR(found.st_mode) else 'not a regular file'}")
        if found.st_size > limit:
            raise InputError(f"{path}: larger than any file of its kind taken here ({_size(limit)})")
        try:
            yield file
        except OSError as error:
            raise InputError(f"{path}: {error.strerror or error}") from None


def read_bytes(path: str | os.PathLike, limit: int = MAX_BYTES) -> bytes:
    """All of a regular file of at most `limit` bytes."""
    with open_regular(path, limit) as file:
        return file.read()


def read_text(path: str | os.PathLike, limit: int, errors: str = "strict") -> str:
    """All of a regular UTF-8 file of at most `limit` bytes."""
    try:
        return read_bytes(path, limit).decode("utf-8", errors)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({first_line(error)})") from None


def read_json(path: str | os.PathLike) -> dict:
    """A JSON object from a file of bounded size."""
    data = read_bytes(path, MAX_JSON_BYTES)
    try:
        record = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({first_line(error)})") from None
    if not isinstance(record, dict):
        raise InputError(f"{path}: not a JSON object")
    return record


def read_toml(path: str | os.PathLike) -> dict:
    """What a TOML file of settings says."""
    data = read_bytes(path, MAX_TOML_BYTES)
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML ({first_line(error)})") from None


def read_npy(path: str | os.PathLike) -> np.ndarray:
    """One array from a .npy file; never unpickles, and takes no more memory than the file's own size."""
    with open_regular(path) as file:
        try:
            return _read_array(file, os.fstat(file.fileno()).st_size)
        except (ValueError, EOFError, SyntaxError) as error:
            raise InputError(f"{path}: not a readable .npy array ({first_line(error)})") from None


def read_npz(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """All arrays of a .npz file; never unpickles, and refuses what would unpack to more than `MAX_BYTES`."""
    with open_regular(path) as file:
        try:
            return _read_archive(file)
        except (MemoryError, OSError):
            raise
        except Exception as error:
            # Damage shows itself as almost any error of zipfile, of the decompressors and of numpy.
            known = (ValueError, EOFError, SyntaxError, zipfile.BadZipFile, NotImplementedError, RuntimeError)
            if not isinstance(error, known) and type(error).__module__ not in ("zlib", "_lzma", "lzma"):
                raise
            raise InputError(f"{path}: not a readable .npz archive ({first_line(error)})") from None


def _read_archive(file: BinaryIO) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(file) as archive:
        members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
        if sum(m.file_size for m in members) > MAX_BYTES:
            raise ValueError(f"it would unpack to more than {_size(MAX_BYTES)}")
        arrays = {}
        for member in members:
            with archive.open(member) as packed:
                arrays[member.filename[:-4]] = _read_array(packed, member.file_size)
        return arrays


def _read_array(file: object, size: int) -> np.ndarray:
    """Like numpy.lib.format.read_array, but checks the declared shape against the bytes there are before allocating."""
    version = np.lib.format.read_magic(file)
    reader = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if reader is None:
        raise ValueError(f"npy version {version}")
    # numpy takes as much memory as the header says it is long, so the length is looked at first.
    size_of_length = 2 if version == (1, 0) else 4
    length = file.read(size_of_length)
    if int.from_bytes(length, "little") > MAX_HEADER_BYTES:
        raise ValueError("its header is too long")
    header = file.read(int.from_bytes(length, "little"))
    try:
        shape, fortran, dtype = reader(io.BytesIO(length + header))
    except (SyntaxError, TypeError, tokenize.TokenError, RecursionError, MemoryError) as error:
        raise ValueError(f"its header is not one ({first_line(error)})") from None
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never loaded")
    count, spread = math.prod(shape), math.prod(extent for extent in shape if extent)
    # An array without elements may still claim 2^40 rows, which nobody should count through.
    if min(shape, default=0) < 0 or count * dtype.itemsize > min(size, MAX_BYTES) or spread > MAX_BYTES:
        raise ValueError(f"it declares {dtype} of shape {shape}, more than the file holds")
    data = file.read(count * dtype.itemsize)
    if len(data) != count * dtype.itemsize:
        raise ValueError("it is truncated")
    array = np.frombuffer(bytearray(data), dtype)
    return array.reshape(shape[::-1]).T if fortran else array.reshape(shape)


def _size(count: int) -> str:
    return f"{count >> 30} GiB" if count >= 1 << 30 else f"{count >> 20} MiB" if count >= 1 << 20 else f"{count} bytes"
