"""What an experiment leaves: numbers as JSON and CSV, figures as PNG and SVG, words, and its configuration."""

from __future__ import annotations

import csv
import io
import platform
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from PIL import Image

from cloak_core import __version__
from cloak_core.detectors import THRESHOLD
from cloak_core.evaluate.controls import CLOTHING, LOGO
from cloak_core.evaluate.experiments.lab import Lab
from cloak_core.evaluate.experiments.repeats import CURVES
from cloak_core.evaluate.figures import (
    CYCLE,
    DASHES,
    INK,
    MARKERS,
    SERIES,
    legend_above,
    new_figure,
    percent_axis,
    save_figure,
)
from cloak_core.evaluate.rates import THRESHOLDS
from cloak_core.evaluate.report.words import short_name
from cloak_core.files.writing import write_json, write_text
from cloak_core.scene.pictures import save_picture


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
    pictures: dict[str, Image.Image] = field(default_factory=dict)
    """Contact sheets."""


def write_outcome(name: str, outcome: Outcome, lab: Lab) -> dict:
    """Write OUT/NAME/ and return what `--json` prints."""
    folder = lab.options.out / name
    folder.mkdir(parents=True, exist_ok=True)
    figures, thresholds = [], threshold_rows(outcome.rows)
    drawn = outcome.figures | ({"thresholds": plot} if (plot := threshold_figure(thresholds)) else {})
    for key, figure in drawn.items():
        figures += [path.name for path in save_figure(figure, folder / key)]
    for key, picture in outcome.pictures.items():
        save_picture(folder / f"{key}.jpg", picture.convert("RGB"), quality=85, optimize=True)
        figures.append(f"{key}.jpg")
    rows = [{key: value for key, value in row.items() if key != CURVES} for row in outcome.rows]
    write_csv(folder / "numbers.csv", rows)
    if thresholds:
        write_csv(folder / "thresholds.csv", thresholds)
    record = {
        "experiment": name,
        "title": outcome.title,
        "rows": rows,
        "thresholds": thresholds,
        "paper": outcome.paper,
        "words": outcome.words,
        "figures": figures,
        "counts": lab.options.counts(),
    }
    write_text(folder / "words.md", f"# {outcome.title}\n\n" + "\n\n".join(outcome.words) + "\n")
    write_json(
        folder / "config.json",
        {"command": lab.options.command} | lab.options.counts() | lab.materials.record() | environment(),
    )
    write_json(folder / "numbers.json", record)
    return record


def threshold_rows(rows: list[dict]) -> list[dict]:
    """One row per row of the table and control: success at every threshold."""
    found = []
    for row in rows:
        label = {key: value for key, value in row.items() if key in list(row)[: list(row).index("success")]}
        for control, curve in row.get(CURVES, {}).items():
            values = {f"at_{t:g}": value for t, value in zip(THRESHOLDS, curve, strict=True)}
            found.append(label | {"control": control} | values)
    return found


def threshold_figure(rows: list[dict]) -> Figure | None:
    """Success of the trained colours against the threshold, a line for each row of the table; None for too many.

    Own clothing is drawn for the first: what the choice of a threshold does to the clean detector.
    """
    mine = [row for row in rows if row["control"] == LOGO]
    if not 1 <= len(mine) <= len(CYCLE):
        return None
    labels = _labels(mine)
    figure, (axis,) = new_figure()
    curve = lambda row: [row[f"at_{t:g}"] for t in THRESHOLDS]
    for k, (label, row) in enumerate(zip(labels, mine, strict=True)):
        axis.plot(THRESHOLDS, curve(row), color=CYCLE[k], marker=MARKERS[k], ls=DASHES[k], label=label, clip_on=False)
    own = next(row for row in rows if row["control"] == CLOTHING)
    judges = [str(row.get("tested_on", row.get("detector", ""))) for row in (own, *mine)]
    label = SERIES[CLOTHING].label + (f", seen by {short_name(judges[0])}" if len(set(judges)) > 1 else "")
    axis.plot(THRESHOLDS, curve(own), color=INK, lw=1.2, ls=(0, (1, 2)), label=label, clip_on=False)
    axis.axvline(THRESHOLD, color=INK, lw=0.8, ls=":", zorder=0)
    percent_axis(axis)
    axis.set_xlabel("detection threshold")
    legend_above(figure)
    return figure


def _labels(rows: list[dict]) -> list[str]:
    """What tells the rows apart, in words; the logo's area only where nothing else does."""
    known = ("control", "seconds", "cpu_seconds", "area_share", "logo_faces", "reach")
    keys = [k for k in rows[0] if k not in known and not k.startswith("at_")]
    for more in ([], ["area_share"]):
        told = [k for k in (*keys, *more) if len({str(row.get(k)) for row in rows}) > 1]
        labels = [", ".join(_named(key, row[key]) for key in told) or SERIES[LOGO].label for row in rows]
        if len(set(labels)) == len(labels):
            break
    return labels


def _named(key: str, value: object) -> str:
    if key == "area_share":
        return f"{100 * value:.1f} %"
    if key == "tested_on":
        return f"seen by {short_name(value)}"
    if isinstance(value, str):
        return short_name(value) if key in ("detector", "trained_on") else value
    return f"{key.replace('_', ' ')} {value:g}"


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
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns)
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())
