"""What decides an object's answers: a hash of the code, numbers and plain values that can be reached from it.

Two functions of one source may answer differently: by what they close over, by defaults, by attributes of the object
that they are methods of. Python's own pickler follows all of these; what it would store by name alone (functions,
classes) is followed here, bytecode and the globals that it names included. What belongs to an installed package is
known by its name and version. Nothing is ever unpickled.
"""

from __future__ import annotations

import dis
import enum
import functools
import hashlib
import importlib.util
import logging
import os
import pickle
import site
import sys
import sysconfig
import types
import uuid
from pathlib import Path

import torch

from cloak_core.files.identity import UNKNOWN

MOST = 1 << 18
"""Objects that are followed."""
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
Told = tuple[type, tuple, tuple]
"""As `reducer_override` answers: words that tell the object, then what it refers to (the "state", which may lead back
to the object itself)."""


def content_of(thing: object) -> str:
    """SHA-256 (hex) of all that can be reached from an object, or words that equal no others where it cannot be known.

    Not known: what other languages hold (a session of a runtime, a socket), a running generator, more than `MOST`
    objects. Another Python makes another hash of the same code.
    """
    digest = hashlib.sha256()
    try:
        _Pickler(types.SimpleNamespace(write=digest.update), 4).dump(thing)
    except Exception:  # these are anybody's objects: looking at them may fail in any way
        return f"{UNKNOWN} {uuid.uuid4().hex}"
    return digest.hexdigest()


class _Pickler(pickle._Pickler):
    """The pickler written in Python, because that one asks `reducer_override` about every object."""

    def memoize(self, obj: object) -> None:
        """Remember an object, to be told by its number where it is met again; equal words are often several objects."""
        if len(self.memo) >= MOST:
            raise ValueError("more objects than are followed")
        if not isinstance(obj, (str, bytes)):
            super().memoize(obj)

    def reducer_override(self, obj: object) -> object:
        """Tell what an object is and what it refers to; any exception: it cannot be known."""
        if obj is object or (type(obj) in pickle._Pickler.dispatch and not isinstance(obj, _FOLLOWED)):
            return NotImplemented
        follow = next((follow for kind, follow in _KINDS if isinstance(obj, kind)), _object)
        return follow(obj)


def _told(*words: object, of: tuple = ()) -> Told:
    return object, words, of


def _object(thing: object) -> Told:
    """Tell an object by its class, its attributes, and what it would be made of again."""
    named = [vars(kind).get("__slots__", ()) for kind in type(thing).__mro__]
    slots = {name for part in named for name in ([part] if isinstance(part, str) else part)}
    values = [(name, getattr(thing, name)) for name in sorted(slots) if hasattr(thing, name)]
    made = thing.__reduce_ex__(4)  # TypeError where there is more to it than Python sees
    parts = made if isinstance(made, str) else [*made[:3], *(list(part or ()) for part in made[3:5])]
    return _told("object", of=(type(thing), dict(getattr(thing, "__dict__", {})), values, parts))


def _tensor(tensor: torch.Tensor) -> Told:
    flat = tensor.detach().cpu().flatten().clone(memory_format=torch.contiguous_format)
    return _told("tensor", str(tensor.dtype), tuple(tensor.shape), flat.view(torch.uint8).numpy().tobytes())


def _function(function: types.FunctionType) -> Told:
    cells = [cell.cell_contents for cell in function.__closure__ or () if cell != types.CellType()]
    parts = (function.__defaults__, function.__kwdefaults__, cells, function.__dict__)
    code = function.__code__
    if _is_installed(code.co_filename) or str(function.__module__).startswith("cloak_core."):
        return _told("function", code.co_qualname, _version(function.__globals__["__name__"]), of=parts)
    used = [
        (name, _global(function.__globals__[name], attributes))
        for name, attributes in sorted(_globals_of(code).items())
        if name in function.__globals__
    ]
    return _told("function", of=(*parts, code, used))


def _code(code: types.CodeType) -> Told:
    steps, imported = list(dis.get_instructions(code)), []
    for k, name in [(k, step.argval) for k, step in enumerate(steps) if step.opname == "IMPORT_NAME"]:
        module = sys.modules.get(name) or importlib.util.find_spec(name)
        if steps[k - 2].argval or module is None:  # how many packages up it begins
            raise ImportError(name)
        if isinstance(module, types.ModuleType):
            imported.append(_global(module, set(code.co_names)))
        elif module.origin in (None, "built-in", "frozen") or _is_installed(module.origin):
            imported.append(name)
        else:
            raise ImportError(name)
    counts = code.co_flags, code.co_argcount, code.co_kwonlyargcount
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    return _told("code", code.co_code, *counts, *names, of=(code.co_consts, imported))


def _global(value: object, attributes: set[str], inside: tuple[object, ...] = ()) -> object:
    """Find what a name stands for; of a user's module, only what the code uses, as modules may import each other."""
    if not isinstance(value, types.ModuleType) or _is_part_of_package(value):
        return value
    own = [] if value in inside else sorted(attributes & vars(value).keys())
    return [(name, _global(vars(value)[name], attributes, (*inside, value))) for name in own]


def _module(module: types.ModuleType) -> Told:
    if not _is_part_of_package(module):
        raise TypeError("a module of the user, whose every value may decide")
    return _told("module", module.__name__, _version(module.__name__))


def _class(kind: type) -> Told:
    name, module = (kind.__module__, kind.__qualname__), sys.modules.get(kind.__module__)
    if module is not None and _is_part_of_package(module):
        return _told("class", *name, _version(kind.__module__))
    return _told(
        "class", *name, of=(kind.__bases__, [(part, vars(kind)[part]) for part in sorted(vars(kind).keys() - _UNSAID)])
    )


def _builtin(thing: types.BuiltinFunctionType) -> Told:
    owner = () if isinstance(thing.__self__, types.ModuleType) else (thing.__self__,)
    return _told("builtin", thing.__module__, thing.__qualname__, _version(thing.__module__ or ""), of=owner)


_FOLLOWED = (type, types.FunctionType, set, frozenset)
"""Of what the pickler knows by itself: these are followed instead."""
_KINDS = (
    (type, _class),
    (types.FunctionType, _function),
    (types.MethodType, lambda method: _told("method", of=(method.__func__, method.__self__))),
    (types.BuiltinFunctionType, _builtin),
    (types.CodeType, _code),
    (types.ModuleType, _module),
    (staticmethod | classmethod, lambda thing: _told(type(thing).__name__, of=(thing.__func__,))),
    (property, lambda thing: _told("property", of=(thing.fget, thing.fset, thing.fdel))),
    (types.MappingProxyType, lambda thing: _told("mapping", of=(dict(thing),))),
    (logging.Logger, lambda thing: _told("log")),
    (enum.Enum, lambda thing: _told("member", thing.name, of=(type(thing),))),
    (torch.Tensor, _tensor),
    (torch.memory_format | torch.layout, lambda thing: _told(repr(thing))),
    # Each process has another order of strings.
    (set | frozenset, lambda things: _told("set", *sorted(content_of(part) for part in things))),
)
"""How each kind of object is followed; all others as `_object` says."""


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
