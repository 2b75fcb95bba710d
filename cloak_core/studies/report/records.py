"""Tables of measured rows that stay with the project: a CSV file a kind of study, and one of how each was made."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_bytes
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import write_text
from cloak_core.studies.report.charts import SPECS, Rows, detector_names

MAX_BYTES = 64 << 20


def publish_rows(folder: Path, table: str, study: str, rows: Rows, made: Mapping[str, object]) -> Path:
    """Put a study's rows into FOLDER/TABLE.csv in place of its earlier ones; returns the file.

    Detectors stand there by their short names. made: command, versions and counts, a row of FOLDER/studies.csv, where
    paths lose their folders. InputError: a file there is no such table.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = detector_names(rows)
    shown = [
        {key: names.get(str(value), value) if key in SPECS else value for key, value in row.items()} for row in rows
    ]
    told = {key: without_folders(value) if key == "command" else value for key, value in made.items()}
    _replace(folder / "studies.csv", f"{table}/{study}", [told])
    return _replace(folder / f"{table}.csv", study, shown)


def _replace(path: Path, study: str, rows: Rows) -> Path:
    """Write these rows under a study's name into a table, which keeps those of other studies as they are."""
    table = pd.DataFrame([{"study": study} | row for row in rows], dtype=object)
    if path.exists():
        try:
            known = pd.read_csv(io.BytesIO(read_bytes(path, MAX_BYTES)), dtype=str, keep_default_na=False)
            table = pd.concat([known[known["study"] != study], table])
        except (ValueError, KeyError) as error:
            raise InputError(f"{path}: not a table of studies ({error!r})") from None
    write_text(path, table.to_csv(index=False, lineterminator="\n"))
    return path
