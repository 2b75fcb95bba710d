"""Techniques and patterns of other packages: entry points, which run only because the caller named them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Literal, TypeVar

from cloak_core.files.errors import InputError, first_line
from cloak_core.files.identity import source_hash

T = TypeVar("T")


def call_package(
    group: Literal["cloak.techniques", "cloak.patterns"], spec: str, kind: type[T], *arguments: object
) -> tuple[T, dict[str, str]]:
    """Call the entry point that a spec NAME or NAME:TEXT names with TEXT and `arguments`.

    Returns what it made, of type `kind`, and a record: spec, package with its version, SHA-256 of the source that made
    it. InputError: no package has it, or several do; it fails, or makes something else.
    """
    name, _, text = spec.partition(":")
    there = entry_points(group=group)
    points = list(there.select(name=name))
    if len({point.value for point in points}) != 1:
        known = ", ".join(sorted(there.names)) or "none is installed"
        many = "several packages have" if points else "no installed package has"
        raise InputError(f"{spec}: {many} an entry point '{name}' of group {group} (known: {known})")
    point = points[0]
    try:
        make: Callable[..., object] = point.load()
        made = make(text, *arguments)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{spec}: {point.value}: {type(error).__name__}: {first_line(error)}") from error
    if not isinstance(made, kind):
        raise InputError(f"{spec}: {point.value} must return a {kind.__name__}, it returned {type(made).__name__}")
    package = "" if point.dist is None else f"{point.dist.name} {point.dist.version}"
    source = source_hash(Path(str(sys.modules[point.module].__file__)))
    return made, {"spec": spec, "package": package, "sha256": source}
