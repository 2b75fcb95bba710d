"""Records that anyone may have written, checked before they are used: JSON by its shape, CSV tables by their heads.

A shape says what has to stand where in JSON: it is a predicate (`NUMBER`), a list of one shape ([NUMBER]: a list of
numbers), or a dictionary from keys to shapes, in which "key?" may be missing and "*" stands for every other key.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .errors import InputError, first_line
from .reading import MAX_TEXT_BYTES, is_number, read_text

MAX_ROWS = 1 << 20


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


def check_shape(value: object, shape: Shape, what: str, place: str = "") -> object:
    """Check a value and all within it; return a copy that holds what the shape names, and nothing else.

    InputError: `what`, the place in it, and what is asked for there.
    """
    if isinstance(shape, Kind):
        _require(shape.fits(value), value, shape.words, what, place)
        return value
    if isinstance(shape, list):
        _require(isinstance(value, list), value, "a list", what, place)
        return [check_shape(part, shape[0], what, f"{place}[{number}]") for number, part in enumerate(value)]
    _require(isinstance(value, dict), value, "a record", what, place)
    before, checked = f"{place}." if place else "", {}
    named = {key.removesuffix("?"): inner for key, inner in shape.items() if key != "*"}
    for key, inner in named.items():
        if key in value:
            checked[key] = check_shape(value[key], inner, what, f"{before}{key}")
        elif f"{key}?" not in shape:
            raise InputError(f"{what}: {place or 'the record'} has no '{key}'")
    for key in [key for key in value if key not in named] if "*" in shape else ():
        _require(key.isprintable(), key, "a name that can be printed", what, before)
        checked[key] = check_shape(value[key], shape["*"], what, f"{before}{key}")
    return checked


def _require(fits: bool, value: object, words: str, what: str, place: str) -> None:
    if not fits:
        raise InputError(f"{what}: {f'{place}: ' if place else ''}{_shown(value)} is not {words}")


def _shown(value: object) -> str:
    text = re.sub(r"\s+", " ", repr(value))
    return text if len(text) <= 40 else f"{text[:40]}..."


def read_table(path: str | os.PathLike, known: Sequence[str], needed: Sequence[str] = ()) -> list[dict[str, str]]:
    """The rows of a CSV file, by the names in its first line (any case); empty cells are left out.

    InputError: no such file, no CSV, a column that is not `known`, one that is `needed` and not there, a row with more
    cells than the head.
    """
    text = read_text(path, MAX_TEXT_BYTES).removeprefix("\ufeff")  # spreadsheets write a mark of byte order
    if "\0" in text:
        raise InputError(f"{path}: not a readable CSV file (a null character)")
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        lines = [(reader.line_num, line) for line in reader]
    except csv.Error as error:
        raise InputError(f"{path}: not a readable CSV file ({first_line(error)})") from None
    lines = [(number, line) for number, line in lines if any(cell.strip() for cell in line)]
    if not lines or len(lines) > MAX_ROWS:
        raise InputError(f"{path}: {'no line in it' if not lines else f'more than {MAX_ROWS:,} lines'}")
    head = [name.strip().lower() for name in lines[0][1]]
    for name in head:
        if name not in known or head.count(name) > 1:
            problem = "stands there twice" if name in known else f"is not one of {', '.join(known)}"
            raise InputError(f"{path}: column '{name}' {problem}")
    absent = [name for name in needed if name not in head]
    if absent:
        raise InputError(f"{path}: no column '{absent[0]}' in its first line")
    longer = [number for number, line in lines[1:] if len(line) > len(head)]
    if longer:
        raise InputError(f"{path}: line {longer[0]} has more cells than the first")
    rows = [dict(zip(head, line, strict=False)) for _, line in lines[1:]]
    return [{name: cell.strip() for name, cell in row.items() if cell.strip()} for row in rows]


def as_cell(value: object) -> object:
    """Write text as a cell that no spreadsheet takes for a formula: an apostrophe before =, +, -, @, tab and return.

    File names and specs come from others, and a table is opened in a spreadsheet. Other values stay.
    """
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value


def number(row: dict[str, str], name: str, path: str | os.PathLike, default: float | None = None) -> float:
    """A cell as a finite number. InputError: it is none, or is not there and has no default."""
    text = row.get(name)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{path}: {name} {text or ''!r} is not a number")
    return value
