"""Tables that users write: CSV files with a head line, as one record of text for each row."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Sequence

from .errors import InputError, first_line
from .reading import MAX_TEXT_BYTES, read_text

MAX_ROWS = 1 << 20


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
