"""Checks of every type and tensor shape in cloak_core, as its modules are imported."""

import functools
import inspect
import types
import typing
from collections.abc import Callable, Sequence

import jaxtyping
from beartype import BeartypeConf, beartype

_check_shapes = jaxtyping.jaxtyped
_check_types = beartype(conf=BeartypeConf(violation_type=jaxtyping.TypeCheckError))
_nested: dict[types.CodeType, tuple[Callable, Callable]] = {}
"""A nested function as it was defined first, and what checks it."""


def check_rooms(rooms: Sequence[str]) -> None:
    """Check all functions and dataclasses of these packages, which are not imported yet."""
    jaxtyping.jaxtyped = check  # the hook writes this name before each of them
    jaxtyping.install_import_hook(rooms, "beartype.beartype")


def check(function: Callable | None = None, *, typechecker: Callable) -> Callable:
    """Leave types to beartype; jaxtyping keeps the sizes of a call's axes only where shapes are annotated.

    jaxtyping's own check costs a call ten times as much, and looks at each shape twice: a fifth of the tests' time. It
    stays for dataclasses, for generators, and for what beartype cannot check at once, such as names that are imported
    for type checkers alone: jaxtyping leaves those out.
    """
    if function is None:
        return functools.partial(check, typechecker=typechecker)
    if inspect.isclass(function) or inspect.isgeneratorfunction(function):
        return _check_shapes(function, typechecker=typechecker)
    try:
        shaped = any(map(names_shapes, typing.get_type_hints(function, include_extras=True).values()))
        checked = _check_nested(function) if "<locals>" in function.__qualname__ else _check_types(function)
    except Exception:
        return _check_shapes(function, typechecker=typechecker)
    return _with_axes(checked) if shaped else checked


def names_shapes(hint: object) -> bool:
    """Tell whether a type hint holds an array's shape."""
    if inspect.isclass(hint) and issubclass(hint, jaxtyping.AbstractArray):
        return True
    inner = hint if isinstance(hint, list) else typing.get_args(hint)  # a list: the parameters of a Callable
    return any(map(names_shapes, inner))


def _with_axes(checked: Callable) -> Callable:
    """Let an axis have one size in all arguments and the result of a call."""

    @functools.wraps(checked)
    def call(*args: object, **kwargs: object) -> object:
        with _check_shapes("context"):
            return checked(*args, **kwargs)

    return call


def _check_nested(function: Callable) -> Callable:
    """Check a function that is defined anew by each call of another one; what checks it is compiled once."""
    if function.__code__ not in _nested:
        _nested[function.__code__] = function, _check_types(function)
    first, checked = _nested[function.__code__]
    if checked is first:  # nothing is annotated
        return function
    copy = types.FunctionType(checked.__code__, checked.__globals__, checked.__name__, checked.__defaults__)
    copy.__kwdefaults__ = {k: function if v is first else v for k, v in checked.__kwdefaults__.items()}
    return functools.update_wrapper(copy, function)
