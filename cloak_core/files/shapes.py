"""Shapes of records: what has to stand where in JSON that anyone may have written, checked before it is used.

A shape is a predicate (`NUMBER`), a list of one shape ([NUMBER]: a list of numbers), or a dictionary from keys to
shapes, in which "key?" may be missing and "*" stands for every other key.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from .errors import InputError
from .reading import is_number


@dataclass(frozen=True)
class Kind:
    """A predicate, and what it asks for in words."""

    words: str
    fits: Callable[[object], bool]

    def __or__(self, other: Kind) -> Kind:
        return Kind(f"{self.words} or {other.words}", lambda value: self.fits(value) or other.fits(value))


Shape = Kind | list | dict
NUMBER = Kind("a number", is_number)
WHOLE = Kind("a whole number", lambda value: is_number(value) and float(value).is_integer())
SHARE = Kind("a number from 0 to 1", lambda value: is_number(value) and 0 <= value <= 1)
TEXT = Kind("text", lambda value: isinstance(value, str))
FLAG = Kind("true or false", lambda value: isinstance(value, bool))
NOTHING = Kind("null", lambda value: value is None)


def check_shape(value: object, shape: Shape, what: str, place: str = "") -> None:
    """Check a value and all within it. InputError: `what`, the place in it, and what is asked for there."""
    if isinstance(shape, Kind):
        _require(shape.fits(value), value, shape.words, what, place)
    elif isinstance(shape, list):
        _require(isinstance(value, list), value, "a list", what, place)
        for number, part in enumerate(value):
            check_shape(part, shape[0], what, f"{place}[{number}]")
    else:
        _require(isinstance(value, dict), value, "a record", what, place)
        before = f"{place}." if place else ""
        named = {key.removesuffix("?"): inner for key, inner in shape.items() if key != "*"}
        for key, inner in named.items():
            if key in value:
                check_shape(value[key], inner, what, f"{before}{key}")
            elif f"{key}?" not in shape:
                raise InputError(f"{what}: {place or 'the record'} has no '{key}'")
        for key in value.keys() - named.keys() if "*" in shape else ():
            _require(key.isprintable(), key, "a name that can be printed", what, before)
            check_shape(value[key], shape["*"], what, f"{before}{key}")


def _require(fits: bool, value: object, words: str, what: str, place: str) -> None:
    if not fits:
        raise InputError(f"{what}: {f'{place}: ' if place else ''}{_shown(value)} is not {words}")


def _shown(value: object) -> str:
    text = re.sub(r"\s+", " ", repr(value))
    return text if len(text) <= 40 else f"{text[:40]}..."
