"""Records of benchmark runs: what an earlier run left in a folder, and tables of rows."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import pandas as pd

from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_text


def with_earlier(path: Path, key: str, new: dict, order: Iterable[str]) -> dict:
    """Merge what an earlier run left in a JSON file under `key` with what is new, in that order."""
    known = {}
    if path.exists():
        try:
            known = dict(json.loads(path.read_text(encoding="utf-8"))[key])
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: not the record of an earlier run ({error!r})") from None
    return {name: (known | new)[name] for name in order if name in known | new}


def write_rows(path: Path, rows: Iterable[Mapping], machine: Mapping[str, str]) -> None:
    """Write rows of figures as CSV, the machine beside each; the keys of nested figures are joined by "_"."""
    table = pd.json_normalize([dict(row) | dict(machine) for row in rows], sep="_")
    write_text(path, table.to_csv(index=False, lineterminator="\n"))
