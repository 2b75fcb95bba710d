"""Reading arrays out of a pickle without running anything that it says.

The original SMPL models are pickles of numpy arrays, scipy sparse matrices and chumpy objects. Only those are admitted:
arrays are rebuilt from their bytes, everything else becomes an inert record of its state (neither scipy nor chumpy is
imported). Any other name in the file is refused. `pickle_machine` reads the opcodes.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .errors import InputError, first_line
from .pickle_machine import Admitted, DType, PickleMachine, Record, count_of
from .reading import MAX_BYTES, open_regular

__all__ = ["ADMITTED", "ArrayMachine", "Record", "read_pickled_arrays"]

MAX_SELECTIONS = 8
"""Selections of selections (chumpy)."""


def _reconstruct(machine: PickleMachine, kind: object = None, shape: object = None, code: object = None) -> np.ndarray:
    """numpy's empty array, which its state fills."""
    array = np.ndarray((0,), "b")
    machine.empty[id(array)] = array
    return array


def _scalar(machine: PickleMachine, kind: object, data: object) -> np.generic:
    data = data.encode("latin1") if isinstance(data, str) else data
    if not isinstance(kind, DType):
        raise ValueError("a number of no known type")
    return np.frombuffer(data, kind.dtype, 1)[0]


def _from_buffer(machine: PickleMachine, data: object, kind: object, shape: object, order: object) -> np.ndarray:
    """An array as protocol 5 has it."""
    if not isinstance(data, bytes) or not isinstance(kind, DType) or order not in ("C", "F"):
        raise ValueError("an array without numbers")
    numbers = np.frombuffer(data, kind.dtype, count_of(shape))
    return numbers.reshape(shape, order=order)


def _encode(machine: PickleMachine, text: object, encoding: object = "latin1") -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        raise ValueError(f"encoding {encoding!r}")
    machine.charge(len(text))
    return text.encode("latin1")


def _new_object(machine: PickleMachine, kind: object, base: object = None, state: object = None) -> object:
    return machine.call(kind, ())


_NAMED = object()
"""Stands for a class that only serves as an argument."""
ADMITTED: dict[tuple[str, str], object] = {
    ("numpy", "ndarray"): _NAMED,
    ("numpy", "dtype"): DType,
    ("_codecs", "encode"): Admitted(_encode),
    ("copy_reg", "_reconstructor"): Admitted(_new_object),
    ("copyreg", "_reconstructor"): Admitted(_new_object),
}
ADMITTED |= {(module, "object"): _NAMED for module in ("__builtin__", "builtins")}
ADMITTED |= {(module, "bytes"): Admitted(lambda machine: b"") for module in ("__builtin__", "builtins")}
for _core in ("core", "_core"):
    ADMITTED[f"numpy.{_core}.multiarray", "_reconstruct"] = Admitted(_reconstruct)
    ADMITTED[f"numpy.{_core}.multiarray", "scalar"] = Admitted(_scalar)
    ADMITTED[f"numpy.{_core}.numeric", "_frombuffer"] = Admitted(_from_buffer)
RECORDED = re.compile(r"(scipy\.sparse(\.[a-z_]+)? [a-z]{3}_(matrix|array)|chumpy(\.[a-z_]+)* [A-Za-z]+)\Z")


class ArrayMachine(PickleMachine):
    """Admits arrays and records; raises `InputError` with the name of anything else."""

    admitted = ADMITTED
    recorded = RECORDED


def read_pickled_arrays(path: Path) -> dict[str, object]:
    """The dictionary in a pickle, its values arrays where they are arrays, sparse matrices or chumpy arrays.

    Raises `InputError` for any class beyond those (by name; nothing of it is run), damage, and absurd sizes.
    """
    try:
        with open_regular(path, MAX_BYTES) as file:
            machine = ArrayMachine(file, path)
            content = machine.load()
            if not isinstance(content, dict):
                raise InputError(f"{path}: the pickle holds a {type(content).__name__}, not a dictionary of arrays")
            return {str(key): _as_array(value, machine) for key, value in content.items()}
    except (InputError, MemoryError):
        raise
    except Exception as error:  # damage shows itself as almost any error of codecs, struct and numpy
        words = first_line(error)[:160] if isinstance(error, ValueError) else "damaged, or another kind of file"
        raise InputError(f"{path}: not a readable pickle ({words})") from None


def _as_array(value: object, machine: PickleMachine, depth: int = 0) -> object:
    """Dense array of a record that stands for one; anything else as it is. ValueError: a damaged one."""
    if not isinstance(value, Record):
        return value
    if depth == MAX_SELECTIONS:
        raise ValueError("selections of selections without end")
    state = value.state
    if "indptr" in state:
        return _dense(type(value).__name__, state, machine)
    if "x" in state:
        return _as_array(state["x"], machine, depth + 1)
    if "idxs" in state and "a" in state:  # chumpy's Select
        whole, index = _numbers(_as_array(state["a"], machine, depth + 1)), _numbers(state["idxs"])
        machine.charge(index.size * (8 + whole.itemsize))
        picked = whole.reshape(-1)[index.astype(np.int64).reshape(-1)]
        shape = state.get("preferred_shape", picked.shape)
        if count_of(shape) != picked.size:
            raise ValueError("a selection of another shape")
        return picked.reshape(shape)
    return value


def _dense(kind: str, state: dict, machine: PickleMachine) -> np.ndarray:
    """A compressed sparse matrix (csc or csr) as an array."""
    by_column = kind.startswith("csc")
    if not by_column and not kind.startswith("csr"):
        raise ValueError(f"sparse format {kind}")
    shape = state.get("_shape", state.get("shape"))
    machine.charge(count_of(shape) * 8)
    starts, minor, data = (_numbers(state[name]).reshape(-1) for name in ("indptr", "indices", "data"))
    rows, columns = shape
    steps = np.diff(starts.astype(np.int64))
    plain = (
        starts.dtype.kind in "iu" and minor.dtype.kind in "iu" and len(starts) == (columns if by_column else rows) + 1
    )
    if not plain or starts[0] != 0 or steps.min(initial=0) < 0 or not starts[-1] == len(minor) == len(data):
        raise ValueError("a damaged sparse matrix")
    machine.charge(len(minor) * 16)
    major = np.repeat(np.arange(len(steps)), steps)
    matrix = np.zeros((rows, columns))
    np.add.at(matrix, (minor, major) if by_column else (major, minor), data.astype(float))
    return matrix


def _numbers(value: object) -> np.ndarray:
    """An array as it is; numpy would unfold lists of shared lists without end."""
    if not isinstance(value, np.ndarray):
        raise ValueError(f"a {type(value).__name__} in the place of an array")
    return value
