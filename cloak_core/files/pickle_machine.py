"""Read pickles of plain values, arrays and inert records, and run nothing that they say.

Python's own reader, `pickle._Unpickler` (the one in Python, which joblib and pandas derive theirs from, too), calls
whatever a pickle names, sets attributes of anything, and hands numpy states that numpy trusts. So every opcode that
calls, fills or imports something has its own method here, and opcodes that nobody needs are refused. No object of a
foreign class is made. The number of reads is limited, and the memory to a multiple of the file's size.
"""

from __future__ import annotations

import io
import pickle
import re
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np

from .errors import InputError

MAX_READS = 1 << 21
"""Of one pickle: of each opcode and of what follows it; a YOLOv5 checkpoint has 34,000 opcodes."""
MAX_CLASSES = 1 << 12
"""Classes that a pickle may name."""
SPARE_BYTES = 64 << 20
TIMES_THE_FILE = 4
"""No more is made than this many times the file, and `SPARE_BYTES`."""
MAX_AXES = 64
_PLAIN = (str, int, float, bytes, bool, type(None))
"""Types of dictionary keys: hashing nested tuples takes time exponential in their depth."""
_REFUSED = pickle.EXT1 + pickle.EXT2 + pickle.EXT4 + pickle.NEWOBJ_EX + pickle.FROZENSET
_REFUSED += pickle.NEXT_BUFFER + pickle.READONLY_BUFFER
"""Opcodes that nobody needs."""
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


class _Bounded:
    """A file that is read `MAX_READS` times at most, and never beyond its end: a pickle may claim any length."""

    def __init__(self, file: io.BufferedIOBase) -> None:
        self.file, start, self.left = file, file.tell(), MAX_READS
        self.size = file.seek(0, io.SEEK_END)
        file.seek(start)
        self.readline = file.readline

    def read(self, count: int) -> bytes:
        self.left -= 1
        if self.left < 0:
            raise ValueError("more steps than any pickle taken here")
        if count > self.size - self.file.tell():
            raise ValueError("it breaks off")
        return self.file.read(count)


class PickleMachine(pickle._Unpickler):
    """Reads one pickle from a file, by `load`. ValueError, LookupError, TypeError, UnpicklingError ...: damage.

    admitted: functions and values by (module, name); recorded: "module name" of the classes whose objects become
    `Record`s. InputError: any other name.
    """

    admitted: Mapping[tuple[str, str], object] = {}
    recorded = re.compile(r"(?!)")

    def __init__(self, file: io.BufferedIOBase, path: Path, size: int | None = None) -> None:
        """size: of the whole file in bytes, where the pickle is a part of it."""
        bounded = _Bounded(file)
        super().__init__(bounded, encoding="latin1")
        self.path, self.left = path, SPARE_BYTES + TIMES_THE_FILE * (bounded.size if size is None else size)
        self.classes: dict[str, type[Record]] = {}
        self.empty: dict[int, np.ndarray] = {}
        """Arrays that their states will fill, once: filled again, views of them would look at freed memory."""

    def charge(self, count: int) -> None:
        """ValueError: so many bytes more are out of all proportion to the file."""
        self.left -= count
        if self.left < 0:
            raise ValueError("it would take far more memory than the file is large")

    def persistent_load(self, pid: object) -> object:
        """What a reference to something outside the pickle stands for."""
        raise InputError(f"{self.path}: the pickle refers to things outside itself")

    def find_class(self, module: str, name: str) -> object:
        """What a name stands for: something admitted, or a class of records made for it."""
        known = self.admitted.get((module, name))
        if known is not None:
            return known
        whole = f"{module} {name}"
        if not self.recorded.match(whole):
            raise InputError(f"{self.path}: the pickle holds {module}.{name}, which is never loaded")
        if whole not in self.classes:
            if len(self.classes) == MAX_CLASSES:
                raise ValueError(f"more than {MAX_CLASSES:,} classes")
            self.classes[whole] = type(name, (Record,), {"__module__": module})
        return self.classes[whole]

    def call(self, function: object, arguments: object) -> object:
        """What a function or class gives: a record, or what an admitted function makes."""
        if not isinstance(arguments, tuple):
            raise ValueError("arguments that are no tuple")
        if isinstance(function, type) and issubclass(function, Record):
            return function()
        if function is DType:
            return DType(*arguments)
        if not isinstance(function, Admitted):
            raise ValueError("a call of something that is no function")
        return function.make(self, *arguments)

    def _fill(self, array: np.ndarray, state: object) -> None:
        _, shape, kind, by_column, data = state
        data = data.encode("latin1") if isinstance(data, str) else data
        if not isinstance(kind, DType) or not isinstance(data, bytes) or not isinstance(by_column, (int, bool)):
            raise ValueError("an array without numbers")
        count = count_of(shape)
        if count * kind.dtype.itemsize != len(data):
            raise ValueError("an array of another size than its numbers")
        self.charge(len(data))
        array.__setstate__((1, shape, kind.dtype, bool(by_column), data))

    def _instantiate(self, klass: object, args: list) -> None:
        self.append(self.call(klass, tuple(args)))

    def reduce(self, arguments: object) -> None:
        """Replace the function on top of the stack by what it gives."""
        self.append(self.call(self.stack.pop(), arguments))

    def build(self, state: object) -> None:
        """Give what is on top of the stack its state."""
        thing = self.stack[-1]
        if isinstance(thing, Record):
            thing.state = state if isinstance(state, dict) else {}
        elif isinstance(thing, DType):
            thing.set_state(state)
        elif isinstance(thing, np.ndarray) and self.empty.pop(id(thing), None) is not None:
            self._fill(thing, state)
        elif not isinstance(thing, OrderedDict):  # torch hangs notes on its state dictionaries
            raise ValueError(f"a state for a {type(thing).__name__}")

    def put(self, items: list) -> None:
        """Put items into the list, set or dictionary (keys and values in turns) on top of the stack."""
        target = self.stack[-1]
        if type(target) is list:
            target.extend(items)
        elif type(target) is set:
            target.update(map(plain_key, items))
        elif type(target) in (dict, OrderedDict):
            target.update(zip(map(plain_key, items[::2]), items[1::2], strict=True))
        else:
            raise ValueError(f"items for a {type(target).__name__}")

    def new_dictionary(self, items: list) -> None:
        """Push a dictionary of these keys and values, in turns."""
        self.append({})
        self.put(items)

    def refuse_integer(self) -> None:
        """ValueError: four bytes tell its length."""
        raise ValueError("an integer of absurd size")

    dispatch: ClassVar = {code: step for code, step in pickle._Unpickler.dispatch.items() if code not in _REFUSED} | {
        pickle.REDUCE[0]: lambda machine: machine.reduce(machine.stack.pop()),
        pickle.NEWOBJ[0]: lambda machine: machine.reduce(machine.stack.pop()),
        pickle.BUILD[0]: lambda machine: machine.build(machine.stack.pop()),
        pickle.APPEND[0]: lambda machine: machine.put([machine.stack.pop()]),
        pickle.APPENDS[0]: lambda machine: machine.put(machine.pop_mark()),
        pickle.ADDITEMS[0]: lambda machine: machine.put(machine.pop_mark()),
        pickle.SETITEM[0]: lambda machine: machine.put([machine.stack.pop(-2), machine.stack.pop()]),
        pickle.SETITEMS[0]: lambda machine: machine.put(machine.pop_mark()),
        pickle.DICT[0]: lambda machine: machine.new_dictionary(machine.pop_mark()),
        pickle.FRAME[0]: lambda machine: machine.read(8),  # its length: what is in it is read as all else
        pickle.BYTEARRAY8[0]: lambda machine: machine.append(machine.read(int.from_bytes(machine.read(8), "little"))),
        pickle.LONG4[0]: refuse_integer,
    }
    """The step of each opcode, by its byte."""
