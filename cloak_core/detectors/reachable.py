"""What decides an object's answers: a hash of the code, numbers and plain values that can be reached from it.

Two functions of one source may answer differently: by what they close over, by defaults, by attributes of the object
that they are methods of. All of these are followed, through containers, objects, bytecode and the globals that it
names. What belongs to an installed package is known by its name and version.
"""

from __future__ import annotations

import dis
import enum
import functools
import hashlib
import importlib.util
import logging
import os
import site
import sys
import sysconfig
import types
import uuid
from collections.abc import Iterable
from pathlib import Path, PurePath

import numpy as np
import torch

from cloak_core.files.identity import UNKNOWN

MOST = 1 << 18
"""Objects that are followed."""
_PLAIN = (type(None), bool, int, float, complex, str, bytes, type(Ellipsis), type(NotImplemented), range)
_OF_TORCH = (torch.dtype, torch.device, torch.memory_format, torch.layout)
_LIKE = (list, tuple, dict, np.ndarray)
"""Kinds of which an object of a class derived from them is more than its items."""
_UNSAID = {
    *("__dict__", "__weakref__", "__doc__", "__module__", "__annotations__", "__firstlineno__", "__annotate_func__"),
    *("__annotations_cache__", "__static_attributes__", "__slotnames__", "_abc_impl", "__abstractmethods__"),
}
"""Of a class: what decides no answer."""
_FOLDERS = [sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")]
_INSTALLED = tuple(
    os.path.realpath(folder) + os.sep
    for folder in (*_FOLDERS, *site.getsitepackages(), site.getusersitepackages(), Path(__file__).parents[1])
)


def content_of(thing: object) -> str:
    """SHA-256 (hex) of all that can be reached from an object, or words that equal no others where it cannot be known.

    Not known: what other languages hold (a session of a runtime, a socket), a running generator, more than `MOST`
    objects. Another Python makes another hash of the same code.
    """
    walk = _Walk()
    try:
        walk.add(thing)
    except Exception:  # these are anybody's objects: looking at them may fail in any way
        return f"{UNKNOWN} {uuid.uuid4().hex}"
    return walk.digest.hexdigest()


class _Walk:
    """Follows references in depth. An object is told once, and by its number where it is met again."""

    def __init__(self) -> None:
        self.digest = hashlib.sha256()
        self._met: dict[int, tuple[int, object]] = {}
        self._inside: list[types.ModuleType] = []

    def add(self, thing: object) -> None:
        """Add an object and all that it refers to. Any exception: it cannot be known."""
        if type(thing) in _PLAIN or isinstance(thing, (PurePath, *_OF_TORCH)):
            self._say(type(thing).__name__, repr(thing))
        elif id(thing) in self._met:
            self._say("again", self._met[id(thing)][0])
        elif len(self._met) >= MOST:
            raise ValueError("more objects than are followed")
        else:
            # Held, so that no other object gets its address meanwhile.
            self._met[id(thing)] = len(self._met), thing
            follow = next((follow for kinds, follow in _KINDS if isinstance(thing, kinds)), _Walk._object)
            follow(self, thing)
            if isinstance(thing, _LIKE) and type(thing) not in _LIKE:
                self._object(thing)

    def _say(self, *words: object) -> None:
        for word in words:
            data = word if isinstance(word, bytes) else str(word).encode(errors="surrogatepass")
            self.digest.update(len(data).to_bytes(8, "little") + data)

    def _all(self, kind: str, things: Iterable[object]) -> None:
        things = list(things)
        self._say(kind, len(things))
        for thing in things:
            self.add(thing)

    def _object(self, thing: object) -> None:
        """Add an object by its class, its attributes, and what it would be made of again."""
        self._all("object", [type(thing), dict(getattr(thing, "__dict__", {}))])
        named = [vars(kind).get("__slots__", ()) for kind in type(thing).__mro__]
        slots = {name for part in named for name in ([part] if isinstance(part, str) else part)}
        self._all("slots", [(name, getattr(thing, name)) for name in sorted(slots) if hasattr(thing, name)])
        made = thing.__reduce_ex__(4)  # TypeError where there is more to it than Python sees
        parts = [made] if isinstance(made, str) else [*made[:3], *(list(part or ()) for part in made[3:5])]
        self._all("made", parts)

    def _array(self, array: np.ndarray | np.generic) -> None:
        values = np.asarray(array)
        self._say("array", repr(values.dtype), values.shape)
        if values.dtype.hasobject:
            self._all("objects", values.ravel().tolist())
        else:
            self._say(values.tobytes())

    def _tensor(self, tensor: torch.Tensor) -> None:
        flat = tensor.detach().cpu().flatten().clone(memory_format=torch.contiguous_format)
        self._say("tensor", tensor.dtype, tuple(tensor.shape), flat.view(torch.uint8).numpy().tobytes())

    def _function(self, function: types.FunctionType) -> None:
        cells = [cell.cell_contents for cell in function.__closure__ or () if cell != types.CellType()]
        self._all("function", [function.__defaults__, function.__kwdefaults__, *cells, function.__dict__])
        code = function.__code__
        if _is_installed(code.co_filename) or str(function.__module__).startswith("cloak_core."):
            self._say(code.co_qualname, _version(function.__globals__["__name__"]))
            return
        self._code(code)
        for used, attributes in sorted(_globals_of(code).items()):
            if used in function.__globals__:
                self._say(used)
                self._global(function.__globals__[used], attributes)

    def _code(self, code: types.CodeType) -> None:
        self._say("code", code.co_code, code.co_flags, code.co_argcount, code.co_kwonlyargcount)
        self._say(code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        self._all("constants", code.co_consts)
        steps = list(dis.get_instructions(code))
        imports = [(k, step.argval) for k, step in enumerate(steps) if step.opname == "IMPORT_NAME"]
        for k, name in imports:
            module = sys.modules.get(name) or importlib.util.find_spec(name)
            if steps[k - 2].argval or module is None:  # how many packages up it begins
                raise ImportError(name)
            if isinstance(module, types.ModuleType):
                self._global(module, set(code.co_names))
            elif module.origin in (None, "built-in", "frozen") or _is_installed(module.origin):
                self._say("module", name)
            else:
                raise ImportError(name)

    def _global(self, value: object, attributes: set[str]) -> None:
        """Add what a name stands for: of a module of the user's, what the code may ask of it."""
        if not isinstance(value, types.ModuleType) or _is_part_of_package(value):
            self.add(value)
        elif value not in self._inside:  # modules may import each other
            self._inside.append(value)
            for name in sorted(attributes & vars(value).keys()):
                self._say(name)
                self._global(vars(value)[name], attributes)
            self._inside.pop()

    def _module(self, module: types.ModuleType) -> None:
        if not _is_part_of_package(module):
            raise TypeError("a module of the user, whose every value may decide")
        self._say("module", module.__name__, _version(module.__name__))

    def _class(self, kind: type) -> None:
        self._say("class", kind.__module__, kind.__qualname__)
        module = sys.modules.get(kind.__module__)
        if module is not None and _is_part_of_package(module):
            self._say(_version(kind.__module__))
            return
        own = vars(kind)
        self._all("bases", kind.__bases__)
        self._all("parts", (part for name in sorted(own.keys() - _UNSAID) for part in (name, own[name])))

    def _builtin(self, thing: types.BuiltinFunctionType) -> None:
        self._say("builtin", thing.__module__, thing.__qualname__, _version(thing.__module__ or ""))
        if not isinstance(thing.__self__, types.ModuleType):
            self.add(thing.__self__)


_KINDS = (
    (type, _Walk._class),
    (types.FunctionType, _Walk._function),
    (types.MethodType, lambda walk, thing: walk._all("method", [thing.__func__, thing.__self__])),
    (types.BuiltinFunctionType, _Walk._builtin),
    (types.CodeType, _Walk._code),
    (types.ModuleType, _Walk._module),
    (staticmethod | classmethod, lambda walk, thing: walk._all(type(thing).__name__, [thing.__func__])),
    (property, lambda walk, thing: walk._all("property", [thing.fget, thing.fset, thing.fdel])),
    (functools.partial, lambda walk, thing: walk._all("partial", [thing.func, thing.args, thing.keywords])),
    (
        types.WrapperDescriptorType
        | types.MethodDescriptorType
        | types.GetSetDescriptorType
        | types.MemberDescriptorType,
        lambda walk, thing: walk._all("descriptor", [thing.__objclass__, thing.__name__]),
    ),
    (logging.Logger, lambda walk, thing: walk._say("log")),
    (enum.Enum, lambda walk, thing: walk._all("member", [type(thing), thing.name])),
    (torch.Tensor, _Walk._tensor),
    (np.ndarray | np.generic, _Walk._array),
    (
        dict | types.MappingProxyType,
        lambda walk, thing: walk._all("dict", (part for pair in thing.items() for part in pair)),
    ),
    (list | tuple, lambda walk, thing: walk._all(type(thing).__name__, thing)),
    # Each process has another order of strings.
    (set | frozenset, lambda walk, thing: walk._say("set", *sorted(content_of(part) for part in thing))),
)
"""How each kind of object is followed; all others as `_Walk._object` says."""


def _globals_of(code: types.CodeType) -> dict[str, set[str]]:
    """Names of globals that the code, or code within it, reads, and all names that it may ask of them."""
    names: dict[str, set[str]] = {}
    codes = [code]
    for inner in codes:  # grows by the code within it
        codes += [const for const in inner.co_consts if isinstance(const, types.CodeType)]
        for step in dis.get_instructions(inner):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                names.setdefault(step.argval, set()).update(inner.co_names)
    return names


def _is_part_of_package(module: types.ModuleType) -> bool:
    """Tell whether a module belongs to Python or to an installed package, which its version tells."""
    file = getattr(module, "__file__", None)
    return getattr(module, "__spec__", None) is not None if file is None else _is_installed(file)


@functools.cache
def _is_installed(file: str) -> bool:
    return file.startswith("<frozen ") or os.path.realpath(file).startswith(_INSTALLED)


def _version(module: str) -> str:
    return str(getattr(sys.modules.get(module.partition(".")[0]), "__version__", ""))
