"""Reading files that anyone may have made: regular ones of bounded size, in one line that names the file when not.

Nothing is unpickled, and sizes are checked before memory is taken.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
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
MAX_ARRAY_BYTES = 1 << 30
"""Of all arrays of a file together: whoever checks and converts them needs some more."""
MAX_TEXT_BYTES = 16 << 20
MAX_JSON_BYTES = 16 << 20
MAX_JSON_VALUES = 1 << 22
MAX_TOML_BYTES = 1 << 20
MAX_HEADER_BYTES = 64 << 10
"""Of a .npy file."""
MAX_DIRECTORY_BYTES = 4 << 20
"""Of an archive's list of members."""
PIECE = 1 << 20
"""Bytes that are read at once."""
_NESTED_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){32}""")
"""A TOML key of 33 parts, a.a.a...: tomllib takes time and memory that grow with their square."""


@contextlib.contextmanager
def open_regular(path: str | os.PathLike, limit: int = MAX_BYTES) -> Iterator[BinaryIO]:
    """A regular file of at most `limit` bytes, open for reading; what the system has against it is an `InputError`.

    A named pipe, device, socket or folder is refused at once: it is never waited for.
    """
    path = Path(path)
    try:
        # Opening a named pipe waits for somebody to write into it unless told not to.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or first_line(error)}") from None
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode) or status.st_size > limit:
        os.close(handle)
        too_large = f"larger than any file of its kind taken here ({_size(limit)})"
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "not a regular file"
        raise InputError(f"{path}: {too_large if stat.S_ISREG(status.st_mode) else kind}")
    with os.fdopen(handle, "rb") as file:
        try:
            yield file
        except OSError as error:
            raise InputError(f"{path}: {error.strerror or error}") from None


def read_bytes(path: str | os.PathLike, limit: int = MAX_BYTES) -> bytes:
    """All of a regular file of at most `limit` bytes."""
    with open_regular(path, limit) as file:
        return file.read()


def read_ahead(path: str | os.PathLike) -> None:
    """Have the system read a file into its cache meanwhile, where it takes such advice."""
    if not hasattr(os, "posix_fadvise"):
        return
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:  # whoever reads it says so
        return
    try:
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_WILLNEED)
    finally:
        os.close(handle)


def read_text(path: str | os.PathLike, limit: int, errors: str = "strict") -> str:
    """All of a regular UTF-8 file of at most `limit` bytes."""
    try:
        return read_bytes(path, limit).decode("utf-8", errors)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({first_line(error)})") from None


def read_json(path: str | os.PathLike, most_bytes: int = MAX_JSON_BYTES, most_values: int = MAX_JSON_VALUES) -> dict:
    """A JSON object from a file of bounded size."""
    return parse_json(read_bytes(path, most_bytes), str(path), most_values)


def parse_json(data: bytes, name: str, most_values: int = MAX_JSON_VALUES) -> dict:
    """A JSON object, none of whose integers is beyond 64 bits. `name` tells where the data come from."""
    if len(data) > most_values and sum(map(data.count, (b",", b"[", b"{"))) > most_values:
        raise InputError(f"{name}: more values than any record taken here ({most_values:,})")
    try:
        record = _DECODER.decode(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not valid JSON ({first_line(error)})") from None
    if not isinstance(record, dict):
        raise InputError(f"{name}: not a JSON object")
    return record


def read_toml(path: str | os.PathLike) -> dict:
    """What a TOML file of settings says; no integer is beyond 64 bits, no key has more than 32 parts."""
    data = read_bytes(path, MAX_TOML_BYTES)
    try:
        text = data.decode("utf-8")
        if _NESTED_KEY.search(text):
            raise ValueError("a key of more than 32 parts")
        record = tomllib.loads(text)
        _check_integers(record)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML ({first_line(error)})") from None
    return record


def is_number(value: object) -> bool:
    """Whether a value read from JSON or TOML is a finite number; true and false are none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _integer(text: str) -> int:
    """ValueError: an integer beyond 64 bits, which neither arrays nor messages can take."""
    value = int(text)
    if len(text) > 18:
        _check_integers(value)
    return value


_DECODER = json.JSONDecoder(parse_int=_integer)


def _check_integers(value: object) -> None:
    """ValueError: an integer beyond 64 bits in a record."""
    if isinstance(value, int) and not -(1 << 63) <= value < 1 << 64:
        raise ValueError("an integer of more than 64 bits")
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _check_integers(part)


def read_npy(path: str | os.PathLike) -> np.ndarray:
    """One array from a .npy file; never unpickles, and takes no more memory than the file's own size."""
    with open_regular(path) as file:
        try:
            return _read_array(file, os.fstat(file.fileno()).st_size)
        except (ValueError, EOFError, SyntaxError) as error:
            raise InputError(f"{path}: not a readable .npy array ({first_line(error)})") from None


def read_npz(path: str | os.PathLike, most_bytes: int = MAX_ARRAY_BYTES) -> dict[str, np.ndarray]:
    """All arrays of a .npz file; never unpickles, and refuses what would unpack to more than `most_bytes`, or
    `MAX_ARRAY_BYTES`."""
    with open_regular(path) as file:
        try:
            check_directory(file)
            with zipfile.ZipFile(file) as archive:
                members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
                most_bytes = min(most_bytes, MAX_ARRAY_BYTES)
                if sum(m.file_size for m in members) > most_bytes:
                    raise ValueError(f"it would unpack to more than {_size(most_bytes)}")
                arrays = {}
                for member in members:
                    with archive.open(member) as packed:
                        arrays[member.filename[:-4]] = _read_array(packed, member.file_size)
                return arrays
        except (MemoryError, OSError):
            raise
        except Exception as error:
            # Damage shows itself as almost any error of zipfile, of the decompressors and of numpy.
            known = (ValueError, EOFError, SyntaxError, zipfile.BadZipFile, NotImplementedError, RuntimeError)
            if not isinstance(error, known) and type(error).__module__ not in ("zlib", "_lzma", "lzma"):
                raise
            words = "another kind of file" if str(error) == "File is not a zip file" else first_line(error)
            raise InputError(f"{path}: not a readable .npz archive ({words})") from None


def check_directory(file: BinaryIO) -> None:
    """ValueError: a zip archive whose list of members zipfile would need too much memory for."""
    size = file.seek(0, io.SEEK_END)
    file.seek(max(0, size - (1 << 16) - 128))
    tail = file.read()
    for match in re.finditer(b"PK\5\6", tail):
        length = int.from_bytes(tail[match.start() + 12 : match.start() + 16], "little")
        more = tail[max(0, match.start() - 76) : match.start()]  # where zip64 says it once more, and counts
        if more.startswith(b"PK\6\6") and more[56:].startswith(b"PK\6\7"):
            length = int.from_bytes(more[40:48], "little")
        if length > MAX_DIRECTORY_BYTES:
            raise ValueError("too many members, or too large")


def _read_array(file: io.BufferedIOBase, size: int) -> np.ndarray:
    """Like numpy.lib.format.read_array, but checks the declared shape against the bytes there are before allocating."""
    shape, fortran, dtype = _read_header(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never loaded")
    count, spread = math.prod(shape), math.prod(extent for extent in shape if extent)
    # An array without elements may still claim 2^40 rows, which nobody should count through.
    if min(shape, default=0) < 0 or count * dtype.itemsize > min(size, MAX_ARRAY_BYTES) or spread > MAX_ARRAY_BYTES:
        raise ValueError(f"it declares {dtype} of shape {shape}, more than the file holds")
    if not dtype.itemsize:
        raise ValueError("its elements take no bytes")
    array = np.empty(count, dtype)
    space = array.view(np.uint8)
    for start in range(0, space.size, PIECE):
        data = file.read(min(PIECE, space.size - start))
        if len(data) < min(PIECE, space.size - start):
            raise ValueError("it is truncated")
        space[start : start + PIECE] = np.frombuffer(data, np.uint8)
    return array.reshape(shape[::-1]).T if fortran else array.reshape(shape)


def _read_header(file: io.BufferedIOBase) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether columns come first, and type of a .npy file's array."""
    try:
        version = np.lib.format.read_magic(file)
    except ValueError:
        raise ValueError("another kind of file") from None
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
        return reader(io.BytesIO(length + header))
    except (SyntaxError, TypeError, tokenize.TokenError, RecursionError, MemoryError) as error:
        raise ValueError(f"its header is not one ({first_line(error)})") from None


def _size(count: int) -> str:
    return f"{count >> 30} GiB" if count >= 1 << 30 else f"{count >> 20} MiB" if count >= 1 << 20 else f"{count} bytes"
