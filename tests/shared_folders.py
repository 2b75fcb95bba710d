"""Folders that one of a run's processes fills and all read."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from cloak_core.files.writing import lock


def fill_once(tmp_path_factory: pytest.TempPathFactory, name: str, fill: Callable[[Path], object]) -> Path:
    """Return the run's folder `name`, made and filled by the first process that asks; the others wait for it."""
    base = tmp_path_factory.getbasetemp()
    if base.name.startswith("popen-"):  # of one process of pytest-xdist; the run's folder is above it
        base = base.parent
    folder, done = base / name, base / f"{name}.done"
    with lock(base / f"{name}.lock", wait=True):
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)  # of a process that failed
            folder.mkdir()
            fill(folder)
            done.touch()
    return folder
