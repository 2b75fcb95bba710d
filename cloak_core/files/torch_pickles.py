"""Reading what torch.save wrote, whole models too, without running anything that it says; torch itself is not needed.

The file is a zip archive of one pickle and the numbers of its tensors. Tensors become numpy arrays, modules and other
known objects inert records of their state; no class that the pickle names is ever imported. Any other name in it is
refused before it is looked up.
"""

from __future__ import annotations

import contextlib
import io
import re
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .errors import InputError, first_line
from .pickle_machine import Admitted, PickleMachine, count_of, plain_key
from .reading import MAX_BYTES, check_directory, open_regular
from .unpickling import ADMITTED
from .writing import replace_file

MAX_PICKLE_BYTES = 64 << 20
"""Of the pickle alone, without the numbers."""
MAX_MEMBERS = 1 << 14
"""Of an archive: a storage each."""


class _Kind(str):
    """A class of torch's storages: the type of the numbers in it."""


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


def _tensor(
    machine: PickleMachine, storage: object, offset: object, shape: object, strides: object, *unused: object
) -> np.ndarray:
    """A view of a storage; ValueError where it would reach beyond its numbers."""
    count = count_of(shape)
    count_of(strides)
    if not isinstance(storage, np.ndarray) or storage.ndim != 1 or len(shape) != len(strides) or not _whole(offset):
        raise ValueError("a tensor without numbers")
    machine.charge(count * storage.itemsize)  # one number may stand for many, and whoever copies it has them all
    if not count:
        return np.zeros(shape, storage.dtype)
    if offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True)) >= len(storage):
        raise ValueError("a tensor beyond its numbers")
    steps = [step * storage.itemsize for step in strides]
    return np.ndarray(shape, storage.dtype, storage, offset * storage.itemsize, steps)


_DICTIONARY = Admitted(lambda machine, *unused: OrderedDict())
_PARAMETER = Admitted(lambda machine, data, *unused: data)


def _shape(machine: PickleMachine, values: object = ()) -> tuple:
    count_of(values)
    return values


def _set(machine: PickleMachine, values: object = ()) -> set:
    made: set = set()
    if values:
        if not isinstance(values, (list, tuple)):
            raise ValueError("a set of no list")
        machine.charge(64 * len(values))
        made.update(map(plain_key, values))
    return made


def _whole(value: object) -> bool:
    return type(value) is int and value >= 0


_ADMITTED: dict[tuple[str, str], object] = ADMITTED | {
    ("collections", "OrderedDict"): _DICTIONARY,
    ("collections", "defaultdict"): _DICTIONARY,
    ("builtins", "set"): Admitted(_set),
    ("__builtin__", "set"): Admitted(_set),
    ("torch", "Size"): Admitted(_shape),
    ("torch._utils", "_rebuild_tensor_v2"): Admitted(_tensor),
    ("torch._utils", "_rebuild_parameter"): _PARAMETER,
    ("torch._utils", "_rebuild_parameter_with_state"): _PARAMETER,
}
_ADMITTED |= {("torch", name): _Kind(dtype) for name, dtype in _KINDS.items()}
_RECORDED = re.compile(
    r"(?:(?:torch\.nn|torch\.optim|torchvision|ultralytics|models|utils)(?:\.\w+)* [\w.]+"
    r"|(?:argparse|types) (?:Simple)?Namespace|pathlib(?:\._local)? \w*Path|(?:__builtin__|builtins) getattr"
    r"|torch (?:device|dtype|u?int\d+|b?float\d+|bool|strided)|torch\.torch_version TorchVersion)\Z"
)


class TorchMachine(PickleMachine):
    """Admits tensors and records of modules; raises `InputError` with the name of anything else."""

    admitted = _ADMITTED
    recorded = _RECORDED

    def __init__(
        self,
        file: io.BufferedIOBase,
        path: Path,
        archive: zipfile.ZipFile | None = None,
        folder: str = "",
        size: int | None = None,
        is_rewritten: bool = False,
    ) -> None:
        """archive: of `size` bytes, has the numbers in `folder`; is_rewritten: they can be written to.

        `storages` has them by the names of their members.
        """
        super().__init__(file, path, size)
        self.archive, self.folder, self.is_rewritten = archive, folder, is_rewritten
        self.storages: dict[str, np.ndarray] = {}

    def persistent_load(self, pid: object) -> np.ndarray:
        """The numbers of a storage, one-dimensional."""
        if self.archive is None:
            raise InputError(f"{self.path}: written by a torch older than 1.6; load it there and save it with a newer")
        word, kind, key, _, count = pid
        if word != "storage" or not isinstance(kind, _Kind) or not isinstance(key, str) or not _whole(count):
            raise ValueError("a reference to something that is no storage")
        if key not in self.storages:
            data = self.archive.read(f"{self.folder}data/{key}")
            if kind != "bfloat16":
                self.storages[key] = np.frombuffer(bytearray(data) if self.is_rewritten else data, str(kind), count)
            elif self.is_rewritten:
                raise InputError(f"{self.path}: keeps its numbers in bfloat16, which cannot be written here")
            else:  # the upper half of a float32
                self.storages[key] = (np.frombuffer(data, "<u2", count).astype("<u4") << 16).view("<f4")
        return self.storages[key]


def read_torch_pickle(path: Path) -> object:
    """What torch.save wrote into a file: dictionaries and lists, numpy arrays, and `Record`s of modules (`_modules`,
    `_parameters` and `_buffers` in their state).

    Raises `InputError` for any other class (by name; nothing of it is run), a TorchScript archive, torch's format
    before 1.6, damage, and absurd sizes.
    """
    with _opened(path) as machine:
        return machine.load()


def rewrite_torch_pickle(source: Path, target: Path, change: Callable[[object], None]) -> None:
    """Write a file of torch.save again with other numbers: `change` is given what `read_torch_pickle` gives, and writes
    into its arrays. Whatever is no number stays as it is, the pickle to the byte.

    InputError as `read_torch_pickle`, and for numbers in bfloat16.
    """
    with _opened(source, is_rewritten=True) as machine:
        change(machine.load())
        changed = {f"{machine.folder}data/{key}": numbers.tobytes() for key, numbers in machine.storages.items()}

        def write(out: BinaryIO) -> None:
            with zipfile.ZipFile(out, "w") as written:
                for member in machine.archive.infolist():
                    written.writestr(member.filename, changed.get(member.filename) or machine.archive.read(member))

        replace_file(target, write)


@contextlib.contextmanager
def _opened(path: Path, is_rewritten: bool = False) -> Iterator[TorchMachine]:
    """Open an archive, and check it before its pickle is read. InputError as in `read_torch_pickle`."""
    try:
        with open_regular(path, MAX_BYTES) as file:
            is_archive = file.read(4) == b"PK\3\4"
            file.seek(0)
            if not is_archive:  # perhaps torch's format before 1.6: the machine names what of it is never loaded
                for _ in range(4):  # that format's mark, its version, the machine, and only then the content
                    TorchMachine(file, path).load()
                raise ValueError("a bare pickle")
            check_directory(file)
            size = file.seek(0, io.SEEK_END)
            with zipfile.ZipFile(file) as archive:
                folder = _folder_in(archive, path, size)
                pickled = io.BytesIO(archive.read(f"{folder}data.pkl"))
                yield TorchMachine(pickled, path, archive, folder, size, is_rewritten)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # damage shows itself as almost any error of zipfile, codecs, struct and numpy
        raise InputError(f"{path}: not a whole file of torch.save ({first_line(error)[:160]})") from None


def _folder_in(archive: zipfile.ZipFile, path: Path, size: int) -> str:
    """Find the folder of all members in an archive of `size` bytes. InputError, ValueError: none of one model."""
    members = archive.infolist()
    if any(m.filename.endswith("constants.pkl") for m in members):
        raise InputError(f"{path}: a TorchScript archive, a compiled program; give the checkpoint it was made from")
    pickles = [m for m in members if m.filename == "data.pkl" or m.filename.endswith("/data.pkl")]
    if len(pickles) != 1 or len(members) > MAX_MEMBERS:
        raise ValueError("no archive of one model")
    # torch compresses nothing, and no two members share their bytes.
    if pickles[0].file_size > MAX_PICKLE_BYTES or sum(m.file_size for m in members) > size:
        raise ValueError("too large: it would unpack to more than it is")
    folder = pickles[0].filename.removesuffix("data.pkl")
    if any(m.filename == f"{folder}byteorder" for m in members) and archive.read(f"{folder}byteorder") != b"little":
        raise ValueError("big-endian numbers")
    return folder
