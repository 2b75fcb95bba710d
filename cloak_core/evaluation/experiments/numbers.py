"""What an experiment measured: rows of plain values in a file, of which its figures and words are made."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PIL import Image

from cloak_core import __version__
from cloak_core.attack.run_config import environment
from cloak_core.evaluation.experiments.lab import Lab
from cloak_core.evaluation.experiments.repeats import CURVES
from cloak_core.evaluation.rates import THRESHOLDS
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json, write_text
from cloak_core.scene.pictures import save_picture

FORMAT = "cloak experiment 1"
Rows = list[dict]


@dataclass(frozen=True, eq=False)
class Numbers:
    """One experiment's result."""

    rows: Rows
    """The table: one dict of plain values per row, all with the same meaning per key."""
    facts: dict = field(default_factory=dict)
    """What the words say beside the rows: plain values by name."""
    pictures: dict[str, Image.Image] = field(default_factory=dict)
    """Contact sheets, by file name without ending; not read back."""
    counts: dict = field(default_factory=dict)
    """What the experiment did otherwise than the options' counts say."""
    thresholds: Rows = field(default_factory=list)
    """One row per row of the table and control: success at every threshold. Filled in when they are written."""


def write_numbers(folder: Path, name: str, numbers: Numbers, lab: Lab) -> None:
    """Write what was measured into `folder`: numbers.json and .csv, thresholds.csv, pictures and config.json."""
    folder.mkdir(parents=True, exist_ok=True)
    for key, picture in numbers.pictures.items():
        save_picture(folder / f"{key}.jpg", picture.convert("RGB"), quality=85, optimize=True)
    rows = [{key: value for key, value in row.items() if key != CURVES} for row in numbers.rows]
    thresholds = threshold_rows(numbers.rows)
    write_csv(folder / "numbers.csv", rows)
    if thresholds:
        write_csv(folder / "thresholds.csv", thresholds)
    counts = lab.options.counts() | numbers.counts
    config = {"command": lab.options.command} | counts | lab.materials.record() | {"cloak": __version__} | environment()
    write_json(folder / "config.json", config)
    measured = {"rows": rows, "thresholds": thresholds, "facts": numbers.facts, "counts": counts}
    pictures = [f"{key}.jpg" for key in numbers.pictures]
    write_json(folder / "numbers.json", {"format": FORMAT, "experiment": name, "pictures": pictures} | measured)


def read_numbers(folder: Path) -> tuple[dict, Numbers]:
    """The record in numbers.json, and the numbers in it. InputError where an earlier version wrote it."""
    record = read_json(folder / "numbers.json")
    if record.get("format") != FORMAT:
        raise InputError(f"{folder / 'numbers.json'}: not a {FORMAT}; run the experiment again to draw its figures")
    return record, Numbers(record["rows"], record["facts"], thresholds=record["thresholds"])


def threshold_rows(rows: Rows) -> Rows:
    """One row per row of the table and control: success at every threshold."""
    found = []
    for row in rows:
        label = {key: value for key, value in row.items() if key in list(row)[: list(row).index("success")]}
        for control, curve in row.get(CURVES, {}).items():
            values = {f"at_{t:g}": value for t, value in zip(THRESHOLDS, curve, strict=True)}
            found.append(label | {"control": control} | values)
    return found


def write_csv(path: Path, rows: Rows) -> None:
    """All rows; columns in the order they first appear."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns)
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def select(rows: Rows, **values: object) -> Rows:
    """The rows with these values."""
    return [row for row in rows if all(row.get(key) == value for key, value in values.items())]


def group(rows: Rows, key: str) -> dict[Any, Rows]:
    """The rows by what they have under `key`, in order."""
    return {value: select(rows, **{key: value}) for value in dict.fromkeys(row[key] for row in rows)}


def column(rows: Rows, key: str = "success") -> list:
    """One column."""
    return [row[key] for row in rows]


def best_row(rows: Sequence[dict]) -> dict:
    """The row with the highest success."""
    return max(rows, key=lambda row: row["success"])
