"""Merge the figures of several runs in one JSON file."""

import json
from collections.abc import Iterable
from pathlib import Path

from cloak_core.files.errors import InputError


def with_earlier(path: Path, key: str, new: dict, order: Iterable[str]) -> dict:
    """Merge what an earlier run left in a JSON file under `key` with what is new, in that order."""
    known = {}
    if path.exists():
        try:
            known = dict(json.loads(path.read_text(encoding="utf-8"))[key])
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: not the record of an earlier run ({error!r})") from None
    return {name: (known | new)[name] for name in order if name in known | new}
