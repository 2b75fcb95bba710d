"""What an experiment leaves: numbers as JSON and CSV, figures as PNG and SVG, words, and its configuration."""

from __future__ import annotations

import csv
import platform
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from cloak_core import __version__
from cloak_core.evaluate.experiments.lab import Lab
from cloak_core.evaluate.figures import save_figure
from cloak_core.scene.exchange import write_json


@dataclass(frozen=True, eq=False)
class Outcome:
    """One experiment's result."""

    title: str
    rows: list[dict]
    """The table: one dict of plain values per row, all with the same meaning per key."""
    words: list[str]
    """Paragraphs: what was done, what came out, how it compares with the paper. Written from the numbers."""
    figures: dict[str, Figure] = field(default_factory=dict)
    paper: list[dict] = field(default_factory=list)
    """The paper's values for the same question."""


def write_outcome(name: str, outcome: Outcome, lab: Lab) -> dict:
    """Write OUT/NAME/ and return what `--json` prints."""
    folder = lab.options.out / name
    folder.mkdir(parents=True, exist_ok=True)
    figures = []
    for key, figure in outcome.figures.items():
        figures += [path.name for path in save_figure(figure, folder / key)]
    write_csv(folder / "numbers.csv", outcome.rows)
    record = {
        "experiment": name,
        "title": outcome.title,
        "rows": outcome.rows,
        "paper": outcome.paper,
        "words": outcome.words,
        "figures": figures,
        "counts": lab.options.counts(),
    }
    (folder / "words.md").write_text(f"# {outcome.title}\n\n" + "\n\n".join(outcome.words) + "\n", "utf-8")
    write_json(folder / "config.json", lab.options.counts() | lab.materials.record() | environment())
    write_json(folder / "numbers.json", record)
    return record


def environment() -> dict:
    """Versions and the machine's kind."""
    return {
        "cloak": __version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "platform": platform.platform(),
        "threads": torch.get_num_threads(),
    }


def write_csv(path: Path, rows: list[dict]) -> None:
    """All rows; columns in the order they first appear."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
