"""The files of an experiment: numbers.json, tables as CSV, pictures and configuration."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from cloak_core import __version__
from cloak_core.attack.run_config import environment
from cloak_core.evaluation.store import RunStore
from cloak_core.experiments.declaration import Numbers
from cloak_core.experiments.tables import Rows
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json, write_text
from cloak_core.scene.pictures import save_picture

FORMAT = "cloak experiment 1"


def write_numbers(folder: Path, name: str, numbers: Numbers, store: RunStore, more_counts: dict) -> None:
    """Write what was measured into `folder`: numbers.json and .csv, thresholds.csv, pictures and config.json."""
    folder.mkdir(parents=True, exist_ok=True)
    for key, picture in numbers.pictures.items():
        save_picture(folder / f"{key}.jpg", picture.convert("RGB"), quality=85, optimize=True)
    write_csv(folder / "numbers.csv", numbers.rows)
    if numbers.thresholds:
        write_csv(folder / "thresholds.csv", numbers.thresholds)
    counts = store.options.counts() | more_counts
    config = {"command": store.options.command} | counts | store.split.record() | {"cloak": __version__} | environment()
    write_json(folder / "config.json", config)
    measured = {"rows": numbers.rows, "thresholds": numbers.thresholds, "facts": numbers.facts, "counts": counts}
    pictures = [f"{key}.jpg" for key in numbers.pictures]
    write_json(folder / "numbers.json", {"format": FORMAT, "experiment": name, "pictures": pictures} | measured)


def read_numbers(folder: Path) -> tuple[dict, Numbers]:
    """Read the record in numbers.json, and the numbers in it. InputError: an unreadably early version wrote it."""
    record = read_json(folder / "numbers.json")
    if record.get("format") != FORMAT:
        raise InputError(f"{folder / 'numbers.json'}: not a {FORMAT}; run the experiment again to draw its figures")
    return record, Numbers(record["rows"], record["facts"], record["thresholds"])


def write_csv(path: Path, rows: Rows) -> None:
    """Write rows as CSV; columns in the order in which they first appear."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(dict.fromkeys(key for row in rows for key in row)))
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())
