"""The shelf of entries that ship with the project, and `zoo:NAME` as the path of a run folder."""

from __future__ import annotations

import os
import tempfile
from functools import cache
from pathlib import Path

from cloak_core.files.caching import cache_folder
from cloak_core.zoo.entry import Entry, names, read_entry

SHELF = Path(__file__).parent / "entries"
MARK = "zoo:"
_TEMPORARY: list[tempfile.TemporaryDirectory] = []
"""Where nothing is cached: gone when the process ends."""


def shelved() -> list[str]:
    """List the names of all entries."""
    return names(SHELF)


def entry(name: str) -> Entry:
    """Read an entry by its name, with or without `zoo:`. InputError: there is none."""
    return read_entry(SHELF, name.removeprefix(MARK))


def run_path(named: str | os.PathLike) -> Path:
    """Give the path itself; for `zoo:NAME`, a run folder with that entry's colours, logo and record."""
    text = os.fspath(named)
    return _run_of(text.removeprefix(MARK)) if text.startswith(MARK) else Path(text)


@cache
def _run_of(name: str) -> Path:
    found, folder = entry(name), cache_folder("zoo")
    if folder is None:
        _TEMPORARY.append(tempfile.TemporaryDirectory(prefix="cloak-zoo-"))
        folder = Path(_TEMPORARY[-1].name)
    # Named by content: another version's entry of the same name is another folder.
    run = folder / f"{name}-{found.record['colors'][:12]}"
    return run if (run / "colors.npy").exists() else found.write_run(run)
