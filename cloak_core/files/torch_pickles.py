"""Reading what torch.save wrote, whole models too, without running anything that it says; torch itself is not needed.

The file is a zip archive of one pickle and the numbers of its tensors. Tensors become numpy arrays, modules and other
known objects inert records of their state; no class that the pickle names is ever imported. Any other name in it is
refused before it is looked up.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .errors import InputError, first_line
from .reading import MAX_BYTES, check_directory, open_regular
from .unpickling import ADMITTED, ArrayUnpickler
from .writing import replace_file

MAX_PICKLE_BYTES = 64 << 20
"""Of the pickle alone, without the numbers."""


@dataclass(frozen=True)
class _Kind:
    """A class of torch's storages: the type of the numbers in it."""

    dtype: str


_KINDS = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "BFloat16Storage": "bfloat16",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "<i1",
    "ByteStorage": "<u1",
    "BoolStorage": "?",
}


def _tensor(storage: np.ndarray, offset: int, shape: tuple, strides: tuple, *unused: object) -> np.ndarray:
    """A view of a storage; ValueError where it would reach beyond its numbers."""
    plain = all(isinstance(n, int) and n >= 0 for n in (offset, *shape, *strides)) and len(shape) == len(strides)
    if not isinstance(storage, np.ndarray) or not plain:
        raise ValueError("a tensor without numbers")
    if math.prod(shape) == 0:
        return np.zeros(shape, storage.dtype)
    if offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True)) >= len(storage):
        raise ValueError("a tensor beyond its numbers")
    steps = [step * storage.itemsize for step in strides]
    return np.lib.stride_tricks.as_strided(storage[offset:], shape, steps, writeable=storage.flags.writeable)


def _parameter(data: object, *unused: object) -> object:
    return data


def _plain_dict(*unused: object) -> OrderedDict:
    return OrderedDict()


def _shape(values: object = ()) -> tuple:
    return tuple(values)


_ADMITTED = ADMITTED | {
    ("collections", "OrderedDict"): OrderedDict,
    ("collections", "defaultdict"): _plain_dict,
    ("builtins", "set"): set,
    ("__builtin__", "set"): set,
    ("torch", "Size"): _shape,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch._utils", "_rebuild_parameter"): _parameter,
    ("torch._utils", "_rebuild_parameter_with_state"): _parameter,
}
_ADMITTED |= {("torch", name): _Kind(dtype) for name, dtype in _KINDS.items()}
_RECORDED = re.compile(
    r"(?:(?:torch\.nn|torch\.optim|torchvision|ultralytics|models|utils)(?:\.\w+)* [\w.]+"
    r"|(?:argparse|types) (?:Simple)?Namespace|pathlib(?:\._local)? \w*Path|(?:__builtin__|builtins) getattr"
    r"|torch (?:device|dtype|u?int\d+|b?float\d+|bool|strided)|torch\.torch_version TorchVersion)\Z"
)


class TorchUnpickler(ArrayUnpickler):
    """Admits tensors and records of modules; raises `InputError` with the name of anything else."""

    admitted = _ADMITTED
    recorded = _RECORDED

    def __init__(self, file: object, path: Path, archive: zipfile.ZipFile | None = None, folder: str = "") -> None:
        super().__init__(file, path)
        self.archive, self.folder = archive, folder
        self.storages: dict[str, np.ndarray] = {}

    def persistent_load(self, pid: object) -> np.ndarray:
        """The numbers of a storage, one-dimensional."""
        if self.archive is None:
            raise InputError(f"{self.path}: written by a torch older than 1.6; load it there and save it with a newer")
        word, kind, key, _, count = pid
        if word != "storage" or not isinstance(kind, _Kind) or not isinstance(count, int):
            raise ValueError("a reference to something that is no storage")
        if key not in self.storages:
            self.storages[key] = _numbers(self.archive.read(f"{self.folder}data/{key}"), kind.dtype, count)
        return self.storages[key]


def read_torch_pickle(path: Path) -> object:
    """What torch.save wrote into a file: dictionaries and lists, numpy arrays, and `Record`s of modules (`_modules`,
    `_parameters` and `_buffers` in their state).

    Raises `InputError` for any other class (by name; nothing of it is run), a TorchScript archive, torch's format
    before 1.6, damage, and absurd sizes.
    """
    try:
        with open_regular(path, MAX_BYTES) as file:
            start = file.read(4)
            file.seek(0)
            if start == b"PK\3\4":
                return _read_archive(file, path)
            _refuse_pickle(file, path)
    except InputError:
        raise
    except Exception as error:  # damage shows itself as almost any error of zipfile, pickle and numpy
        raise InputError(f"{path}: not a whole file of torch.save ({first_line(error)[:160]})") from None


class _Rewriter(TorchUnpickler):
    """The numbers can be written to, and are remembered by their members of the archive."""

    def persistent_load(self, pid: object) -> np.ndarray:
        known = len(self.storages)
        numbers = super().persistent_load(pid)
        if len(self.storages) > known:
            if pid[1].dtype == "bfloat16":
                raise InputError(f"{self.path}: keeps its numbers in bfloat16, which cannot be written here")
            numbers = self.storages[pid[2]] = numbers.copy()
        return numbers


def rewrite_torch_pickle(source: Path, target: Path, change: Callable[[object], None]) -> None:
    """Write a file of torch.save again with other numbers: `change` is given what `read_torch_pickle` gives, and writes
    into its arrays. Whatever is no number stays as it is, the pickle to the byte.

    InputError as `read_torch_pickle`, and for numbers in bfloat16.
    """
    read_torch_pickle(source)  # refuses what is to be refused
    with open_regular(source, MAX_BYTES) as file, zipfile.ZipFile(file) as archive:
        (pickled,) = (name for name in archive.namelist() if name == "data.pkl" or name.endswith("/data.pkl"))
        folder = pickled.removesuffix("data.pkl")
        unpickler = _Rewriter(io.BytesIO(archive.read(pickled)), source, archive, folder)
        change(unpickler.load())
        changed = {f"{folder}data/{key}": numbers.tobytes() for key, numbers in unpickler.storages.items()}

        def write(out: BinaryIO) -> None:
            with zipfile.ZipFile(out, "w") as written:
                for member in archive.infolist():
                    written.writestr(member.filename, changed.get(member.filename) or archive.read(member))

        replace_file(target, write)


def _read_archive(file: io.BufferedIOBase, path: Path) -> object:
    check_directory(file)
    with zipfile.ZipFile(file) as archive:
        sizes = {member.filename: member.file_size for member in archive.infolist()}
        found = [name for name in sizes if name == "data.pkl" or name.endswith("/data.pkl")]
        if any(name.endswith("constants.pkl") for name in sizes):
            raise InputError(f"{path}: a TorchScript archive, a compiled program; give the checkpoint it was made from")
        if len(found) != 1 or sizes[found[0]] > MAX_PICKLE_BYTES or sum(sizes.values()) > MAX_BYTES:
            raise ValueError("no archive of one model" if len(found) != 1 else "too large")
        folder = found[0].removesuffix("data.pkl")
        if f"{folder}byteorder" in sizes and archive.read(f"{folder}byteorder") != b"little":
            raise ValueError("big-endian numbers")
        return TorchUnpickler(io.BytesIO(archive.read(found[0])), path, archive, folder).load()


def _refuse_pickle(file: io.BufferedIOBase, path: Path) -> None:
    """A bare pickle, perhaps torch's format before 1.6: InputError, which names what of it is never loaded."""
    for _ in range(4):  # that format's mark, its version, the machine, and only then the content
        TorchUnpickler(file, path).load()
    raise ValueError("a bare pickle")


def _numbers(data: bytes, dtype: str, count: int) -> np.ndarray:
    if dtype != "bfloat16":
        return np.frombuffer(data, dtype, count)
    # The upper half of a float32.
    return (np.frombuffer(data, "<u2", count).astype("<u4") << 16).view("<f4")
