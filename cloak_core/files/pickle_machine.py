"""A stack machine that reads pickles of plain values, arrays and inert records, and runs nothing that they say.

Python's own unpickler calls whatever a pickle names, grows a table to any index that it mentions, and hands numpy
states that numpy trusts. Here each opcode has its own few lines, no object of a foreign class exists, and neither the
steps taken nor the memory used exceed what the file's size allows.
"""

from __future__ import annotations

import codecs
import io
import pickletools
import re
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from .errors import InputError
from .pickle_values import Admitted, DType, Record, Sized, count_of, plain_key

MAX_STEPS = 1 << 20
"""Opcodes of one pickle; a YOLOv5 checkpoint has 34,000."""
MAX_CLASSES = 1 << 12
"""Classes that a pickle may name."""
SPARE_BYTES = 64 << 20
TIMES_THE_FILE = 4
"""No more is made than this many times the file, and `SPARE_BYTES`."""
MAX_INTEGER_BYTES = 64


class PickleMachine:
    """Reads one pickle from a file.

    admitted: functions and values by (module, name); recorded: "module name" of the classes whose objects become
    `Record`s. InputError: any other name.
    """

    admitted: Mapping[tuple[str, str], object] = {}
    recorded = re.compile(r"(?!)")

    def __init__(self, file: io.BufferedIOBase, path: Path, size: int | None = None) -> None:
        """size: of the whole file in bytes, where the pickle is a part of it."""
        self.file, self.path = Sized(file), path
        self.left = SPARE_BYTES + TIMES_THE_FILE * (self.file.size if size is None else size)
        self.stack: list = []
        self.marked: list[list] = []
        self.memo: dict[int, object] = {}
        self.classes: dict[str, type[Record]] = {}
        self.empty: dict[int, np.ndarray] = {}

    def load(self) -> object:
        """The value that the pickle describes. ValueError, IndexError, KeyError, TypeError, OverflowError: damage."""
        for _ in range(MAX_STEPS):
            opcode = _OPCODES.get(self.file.read(1))
            if opcode is None:
                raise ValueError("it breaks off" if self.file.file.tell() == self.file.size else "an unknown opcode")
            if opcode.name == "STOP":
                return self.stack.pop()
            _STEPS[opcode.name](self, self._argument(opcode))
        raise ValueError(f"more than {MAX_STEPS:,} steps")

    def charge(self, count: int) -> None:
        """ValueError: so many bytes more are out of all proportion to the file."""
        self.left -= count
        if self.left < 0:
            raise ValueError("it would take far more memory than the file is large")

    def persistent_load(self, pid: object) -> object:
        """What a reference to something outside the pickle stands for."""
        raise InputError(f"{self.path}: the pickle refers to things outside itself")

    def _argument(self, opcode: pickletools.OpcodeInfo) -> object:
        if opcode.arg is None:
            return None
        if opcode.name == "STRING":  # pickletools takes it for ASCII; Python 2 wrote bytes so
            return codecs.escape_decode(self.file.readline().strip()[1:-1])[0].decode("latin1")
        if opcode.name in ("LONG1", "LONG4"):
            count = int.from_bytes(self.file.read(1 if opcode.name == "LONG1" else 4), "little")
            if count > MAX_INTEGER_BYTES:
                raise ValueError("an integer of absurd size")
            return int.from_bytes(self.file.read(count), "little", signed=True)
        return opcode.arg.reader(self.file)

    def find(self, module: object, name: object) -> object:
        """What a name stands for: something admitted, or a class of records made for it."""
        known = self.admitted.get((module, name)) if isinstance(module, str) and isinstance(name, str) else None
        if known is not None:
            return known
        whole = f"{module} {name}"
        if not self.recorded.match(whole):
            raise InputError(f"{self.path}: the pickle holds {module}.{name}, which is never loaded")
        if whole not in self.classes:
            if len(self.classes) == MAX_CLASSES:
                raise ValueError(f"more than {MAX_CLASSES:,} classes")
            self.classes[whole] = type(str(name), (Record,), {"__module__": module})
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

    def new_array(self) -> np.ndarray:
        """An array that its state fills, once: filled again, views of it would look at freed memory."""
        array = np.ndarray((0,), "b")
        self.empty[id(array)] = array
        return array

    def build(self, thing: object, state: object) -> None:
        """Give something its state."""
        if isinstance(thing, Record):
            thing.state = state if isinstance(state, dict) else {}
        elif isinstance(thing, DType):
            thing.set_state(state)
        elif isinstance(thing, np.ndarray) and self.empty.pop(id(thing), None) is not None:
            self._fill(thing, state)
        elif not isinstance(thing, OrderedDict):  # torch hangs notes on its state dictionaries
            raise ValueError(f"a state for a {type(thing).__name__}")

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

    def mark(self) -> list:
        """What stands on the stack above the last mark, which goes."""
        items, self.stack = self.stack, self.marked.pop()
        return items

    def put(self, items: list, into: type) -> None:
        """Append to the list, or add to the set, on top of the stack."""
        target = self.stack[-1]
        if type(target) is not into:
            raise ValueError(f"items for a {type(target).__name__}")
        if into is set:
            target.update(map(plain_key, items))
        else:
            target.extend(items)

    def set_items(self, items: list) -> None:
        """Keys and values in turns, into the dictionary on top of the stack."""
        target = self.stack[-1]
        if type(target) not in (dict, OrderedDict) or len(items) % 2:
            raise ValueError(f"entries for a {type(target).__name__}")
        for key, value in zip(items[::2], items[1::2], strict=True):
            target[plain_key(key)] = value


def _push(machine: PickleMachine, value: object) -> None:
    machine.stack.append(value)


def _get(machine: PickleMachine, index: object) -> None:
    machine.stack.append(machine.memo[index])


def _put(machine: PickleMachine, index: object) -> None:
    machine.memo[index] = machine.stack[-1]


def _memoize(machine: PickleMachine, _: object) -> None:
    machine.memo[len(machine.memo)] = machine.stack[-1]


def _mark(machine: PickleMachine, _: object) -> None:
    machine.marked.append(machine.stack)
    machine.stack = []


def _tuple(count: int) -> Callable[[PickleMachine, object], None]:
    def step(machine: PickleMachine, _: object) -> None:
        if len(machine.stack) < count:
            raise ValueError("a tuple of more than there is")
        machine.stack[len(machine.stack) - count :] = [tuple(machine.stack[len(machine.stack) - count :])]

    return step


def _dict(machine: PickleMachine, _: object) -> None:
    items = machine.mark()
    machine.stack.append({})
    machine.set_items(items)


def _pair(machine: PickleMachine) -> tuple[object, object]:
    last = machine.stack.pop()
    return machine.stack.pop(), last


def _append(machine: PickleMachine, _: object) -> None:
    item = machine.stack.pop()
    machine.put([item], list)


def _set_item(machine: PickleMachine, _: object) -> None:
    machine.set_items(list(_pair(machine)))


def _call(machine: PickleMachine, _: object) -> None:
    machine.stack.append(machine.call(*_pair(machine)))


def _build(machine: PickleMachine, _: object) -> None:
    state = machine.stack.pop()
    machine.build(machine.stack[-1], state)


def _instance(machine: PickleMachine, name: str) -> None:
    arguments = tuple(machine.mark())
    machine.stack.append(machine.call(machine.find(*name.split(" ", 1)), arguments))


def _object(machine: PickleMachine, _: object) -> None:
    kind, *arguments = machine.mark()
    machine.stack.append(machine.call(kind, tuple(arguments)))


_STEPS: dict[str, Callable[[PickleMachine, object], None]] = {
    "PROTO": lambda m, _: None,
    "FRAME": lambda m, _: None,
    "MARK": _mark,
    "POP": lambda m, _: m.stack.pop() if m.stack else m.mark(),
    "POP_MARK": lambda m, _: m.mark(),
    "DUP": lambda m, _: m.stack.append(m.stack[-1]),
    "NONE": lambda m, _: m.stack.append(None),
    "NEWTRUE": lambda m, _: m.stack.append(True),
    "NEWFALSE": lambda m, _: m.stack.append(False),
    "EMPTY_LIST": lambda m, _: m.stack.append([]),
    "EMPTY_TUPLE": lambda m, _: m.stack.append(()),
    "EMPTY_DICT": lambda m, _: m.stack.append({}),
    "EMPTY_SET": lambda m, _: m.stack.append(set()),
    "LIST": lambda m, _: _push(m, m.mark()),
    "TUPLE": lambda m, _: _push(m, tuple(m.mark())),
    "TUPLE1": _tuple(1),
    "TUPLE2": _tuple(2),
    "TUPLE3": _tuple(3),
    "DICT": _dict,
    "APPEND": _append,
    "APPENDS": lambda m, _: m.put(m.mark(), list),
    "ADDITEMS": lambda m, _: m.put(m.mark(), set),
    "SETITEM": _set_item,
    "SETITEMS": lambda m, _: m.set_items(m.mark()),
    "GLOBAL": lambda m, name: m.stack.append(m.find(*name.split(" ", 1))),
    "STACK_GLOBAL": lambda m, _: m.stack.append(m.find(*_pair(m))),
    "REDUCE": _call,
    "NEWOBJ": _call,
    "INST": _instance,
    "OBJ": _object,
    "BUILD": _build,
    "BINPERSID": lambda m, _: m.stack.append(m.persistent_load(m.stack.pop())),
    "PERSID": lambda m, pid: m.stack.append(m.persistent_load(pid)),
    "MEMOIZE": _memoize,
}
"""What each opcode does; those of extensions, of buffers outside the pickle and of frozen sets are unknown here."""
_STEPS |= dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT"), _put) | dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), _get)
_STEPS |= dict.fromkeys(("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"), _push)
_STEPS |= dict.fromkeys(("STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE"), _push)
_STEPS |= dict.fromkeys(("BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8"), _push)
_STEPS["BYTEARRAY8"] = lambda m, data: m.stack.append(bytes(data))
_OPCODES = {op.code.encode("latin1"): op for op in pickletools.opcodes if op.name in _STEPS or op.name == "STOP"}
