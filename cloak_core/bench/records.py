"""Records of benchmark runs: what an earlier run left in a folder, and under what circumstances figures were taken."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json


def with_earlier(path: Path, key: str, new: dict, order: Iterable[str]) -> dict:
    """Merge what an earlier run left in a JSON file under `key` with what is new, in that order."""
    known = {}
    if path.exists():
        try:
            known = dict(json.loads(path.read_text(encoding="utf-8"))[key])
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: not the record of an earlier run ({error!r})") from None
    return {name: (known | new)[name] for name in order if name in known | new}


def write_record(folder: Path, name: str, record: dict, tables: str) -> None:
    """Write a record as NAME.json and its tables as NAME.md."""
    write_json(folder / f"{name}.json", record)
    (folder / f"{name}.md").write_text(tables, encoding="utf-8")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    first, *others = (f"| {' | '.join(cells)} |" for cells in (head, *rows))
    return [first, "|" + "---|" * len(head), *others]


def circumstances(record: dict) -> str:
    """Machine, threads, versions and date of a record, in words."""
    machine = record["machine"]
    versions = {"torch": machine["torch"], "Python": machine["python"]} | record.get("peers", {})
    missing = [name for name, version in versions.items() if version.startswith("missing")]
    words = ", ".join(f"{name} {version}" for name, version in versions.items() if name not in missing)
    absent = f"; not installed: {', '.join(missing)}" if missing else ""
    clock = f", {record['clock']}'s time" if "clock" in record else ""
    cores = f"{machine['device']} ({machine['cores']} cores)"
    return f"Measured {machine['date']} on {cores}, {record['threads']} threads{clock}; {words}{absent}"
