"""Reading arrays out of a pickle without running anything that it says.

The original SMPL models are pickles of numpy arrays, scipy sparse matrices and chumpy objects. Only those are
admitted: arrays are rebuilt by numpy from bytes, everything else becomes an inert record of its state (neither scipy
nor chumpy is imported). Any other name in the file is refused before it is looked up.
"""

from __future__ import annotations

import pickle
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .errors import InputError
from .reading import MAX_BYTES, open_regular


class Record:
    """What is left of an object of a class that is not imported: its class's name and its state."""

    def __new__(cls, *args: object) -> Record:
        record = object.__new__(cls)
        record.state = {}
        return record

    def __init__(self, *args: object) -> None:
        pass

    def __setstate__(self, state: object) -> None:
        self.state = state if isinstance(state, dict) else {}


class _Named:
    """Stands for a class that only serves as an argument; calling it fails."""


def _reconstruct(kind: object, shape: object, code: object) -> np.ndarray:
    """numpy's empty array that its own `__setstate__` fills, checking lengths."""
    return np.ndarray((0,), "b")


def _scalar(dtype: np.dtype, data: bytes | str) -> np.generic:
    return np.frombuffer(data.encode("latin1") if isinstance(data, str) else data, dtype, 1)[0]


def _encode(text: str, encoding: str = "latin1") -> bytes:
    if encoding != "latin1":
        raise ValueError(f"encoding {encoding}")
    return text.encode("latin1")


def _new_object(kind: type, base: object = None, state: object = None) -> Record:
    if not (isinstance(kind, type) and issubclass(kind, Record)):
        raise ValueError("an object of no known class")
    return kind()


ADMITTED = {
    ("numpy", "ndarray"): _Named,
    ("numpy", "dtype"): np.dtype,
    ("_codecs", "encode"): _encode,
    ("copy_reg", "_reconstructor"): _new_object,
    ("copyreg", "_reconstructor"): _new_object,
    ("__builtin__", "object"): _Named,
    ("builtins", "object"): _Named,
}
ADMITTED |= {(f"numpy.{core}.multiarray", "_reconstruct"): _reconstruct for core in ("core", "_core")}
ADMITTED |= {(f"numpy.{core}.multiarray", "scalar"): _scalar for core in ("core", "_core")}
RECORDED = re.compile(r"(scipy\.sparse(\.[a-z_]+)? [a-z]{3}_(matrix|array)|chumpy(\.[a-z_]+)* [A-Za-z]+)\Z")


class ArrayUnpickler(pickle.Unpickler):
    """Admits arrays and records; raises `InputError` with the name of anything else."""

    admitted: Mapping[tuple[str, str], object] = ADMITTED
    recorded = RECORDED

    def __init__(self, file: object, path: Path) -> None:
        super().__init__(file, encoding="latin1")
        self.path = path

    def find_class(self, module: str, name: str) -> object:
        if (module, name) in self.admitted:
            return self.admitted[module, name]
        if self.recorded.match(f"{module} {name}"):
            return type(name, (Record,), {"__module__": module})
        raise InputError(f"{self.path}: the pickle holds {module}.{name}, which is never loaded")

    def persistent_load(self, pid: object) -> object:
        raise InputError(f"{self.path}: the pickle refers to things outside itself")


def read_pickled_arrays(path: Path) -> dict[str, object]:
    """The dictionary in a pickle, its values arrays where they are arrays, sparse matrices or chumpy arrays.

    Raises `InputError` for any class beyond those (by name; nothing of it is run), damage, and absurd sizes.
    """
    try:
        with open_regular(path, MAX_BYTES) as file:
            content = ArrayUnpickler(file, path).load()
    except InputError:
        raise
    except Exception as error:  # a damaged pickle may raise anything at all
        raise InputError(f"{path}: not a readable pickle ({type(error).__name__}: {error})") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: the pickle holds a {type(content).__name__}, not a dictionary of arrays")
    try:
        return {str(key): as_array(value) for key, value in content.items()}
    except (ValueError, IndexError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: a damaged matrix in the pickle ({error})") from None


def as_array(value: object) -> object:
    """Dense array of a record that stands for one; anything else as it is."""
    if not isinstance(value, Record):
        return value
    state = value.state
    if "indptr" in state:
        return dense(type(value).__name__, state)
    if "x" in state:
        return as_array(state["x"])
    if "idxs" in state and "a" in state:  # chumpy's Select
        picked = np.asarray(as_array(state["a"])).reshape(-1)[np.asarray(state["idxs"]).astype(np.int64).reshape(-1)]
        return picked.reshape(state.get("preferred_shape", picked.shape))
    return value


def dense(kind: str, state: dict) -> np.ndarray:
    """A compressed sparse matrix (csc or csr) as an array."""
    rows, columns = (int(extent) for extent in state.get("_shape", state.get("shape")))
    if not 0 <= rows * columns <= MAX_BYTES // 8:
        raise ValueError(f"a sparse matrix of {rows} x {columns}")
    major = np.repeat(np.arange(len(state["indptr"]) - 1), np.diff(state["indptr"]))
    minor = np.asarray(state["indices"])
    by_column = kind.startswith("csc")
    if not by_column and not kind.startswith("csr"):
        raise ValueError(f"sparse format {kind}")
    matrix = np.zeros((rows, columns))
    np.add.at(matrix, (minor, major) if by_column else (major, minor), np.asarray(state["data"], float))
    return matrix
