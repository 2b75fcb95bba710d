"""What a thing is: hashes of content. Resuming, caches, "seen or unseen", white box or black box: all ask here.

A hash tells content alone: where a file lies, how memory is laid out and on which device it is make no difference.
Whether two things are nearly the same is told by `likeness`.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np

TRAINING = ("exchange", "core", "sources", "patterns", "detectors", "techniques", "studies/trainings")
"""The rooms whose code decides the colours of a training."""
UNKNOWN = "unknown"
"""How an identity begins that nothing else has, as what it is of cannot be known."""
_PROJECT = Path(__file__).parents[1]


def sha256_arrays(*arrays: np.ndarray) -> str:
    """SHA-256 (hex) of arrays: their dtypes, shapes and numbers, in order."""
    digest = hashlib.sha256()
    for array in arrays:
        array = np.asarray(array)
        digest.update(f"{array.dtype.newbyteorder('<').str}{array.shape}\n".encode())
        digest.update(array.astype(array.dtype.newbyteorder("<"), "C", copy=False).reshape(-1).view(np.uint8))
    return digest.hexdigest()


def sha256_record(record: object) -> str:
    """SHA-256 (hex) of plain values, whatever the order of names in dictionaries. ValueError: a number not finite."""
    text = json.dumps(record, sort_keys=True, allow_nan=False, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def code_hash(*parts: str) -> str:
    """SHA-256 (hex) of our own source: rooms ("core") and files ("core/cameras.py"), read at the first call.

    FileNotFoundError: there is no such room or file.
    """
    hashes = {}
    for part in parts:
        path = _PROJECT / part
        for file in path.rglob("*.py") if path.is_dir() else [path]:
            hashes[file.relative_to(_PROJECT).as_posix()] = hashlib.sha256(file.read_bytes()).hexdigest()
    return sha256_record(hashes)


def source_hash(file: Path) -> str:
    """SHA-256 (hex) of a Python file and of all it imports from its own folder, directly or through others."""
    files = imported_files(file)
    return sha256_record({name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()})


def imported_files(file: Path) -> dict[str, Path]:
    """A Python file (by "") and all it imports from its own folder, directly or through others, by module names."""
    folder, files = file.parent, {"": file}
    left = [file]
    while left:
        for name in _imports(left.pop()):
            module = folder / name.replace(".", "/")
            for path in (module.with_suffix(".py"), module / "__init__.py"):
                if name not in files and path.is_file():
                    files[name] = path
                    left.append(path)
    return files


def _imports(file: Path) -> Iterable[str]:
    """Names that may be modules in an import anywhere in a file, their packages included."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):  # whoever runs it will say so
        return
    for node in ast.walk(tree):
        names = [alias.name for alias in node.names] if isinstance(node, (ast.Import, ast.ImportFrom)) else []
        if isinstance(node, ast.ImportFrom):
            names = [node.module, *(f"{node.module}.{name}" for name in names)] if node.module else names
        for name in names:
            parts = name.split(".")
            yield from (".".join(parts[:count]) for count in range(1, len(parts) + 1))


def package_versions(*names: str) -> dict[str, str]:
    """The installed versions of packages, by name; those that are not installed are missing."""
    versions = {name: _version(name) for name in names}
    return {name: version for name, version in versions.items() if version is not None}


@cache
def _version(name: str) -> str | None:
    """Read a package's version once in a process: it takes milliseconds, and a store asks for every key."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
