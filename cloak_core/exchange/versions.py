"""Versions of the formats: older ones are read, newer ones refused by name."""

from __future__ import annotations

from pathlib import Path

from ..files.errors import InputError

FORMAT_VERSION = 1


def check_version(record: dict, kind: str, path: Path) -> None:
    if record.get("format") != kind:
        raise InputError(f"{path}: not a {kind} (its format is {record.get('format')!r})")
    version = record.get("version")
    if not isinstance(version, int) or version < 1:
        raise InputError(f"{path}: version is {version!r}")
    if version > FORMAT_VERSION:
        raise InputError(f"{path}: version {version} is newer than this Cloak reads ({FORMAT_VERSION})")
