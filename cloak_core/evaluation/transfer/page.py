"""A leave-one-out matrix as a heat map, and as Markdown for documentation: made of the cells alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.report import plots
from cloak_core.evaluation.report.page import write_page
from cloak_core.evaluation.report.style import SERIES, save_figure, style
from cloak_core.evaluation.report.words import short_name
from cloak_core.evaluation.statistics_card import heat_values
from cloak_core.evaluation.transfer.matrix import summary
from cloak_core.evaluation.transfer.plan import CROSS_FAMILY, SAME_FAMILY
from cloak_core.files.specs import without_folders

MARKS = {SAME_FAMILY: "", CROSS_FAMILY: " *"}


def show(cells: Sequence[dict], folder: Path, name: str, command: str = "") -> list[Path]:
    """Write NAME.png, NAME.svg and NAME.md into the folder: the heat map, and tables for documentation."""
    folder.mkdir(parents=True, exist_ok=True)
    with style():
        files = save_figure(heat_map(cells), folder / name)
    values = {
        "name": name,
        "cells": cells,
        "seeds": max(len(cell["by_seed"]) for cell in cells),
        "ladder": [(ablation, own, summary(own), _judges(own)) for ablation, own in by_ablation(cells).items()],
        "command": without_folders(command),
    }
    return [*files, write_page(folder / f"{name}.md", "transfer.md", values)]


def by_ablation(cells: Sequence[dict]) -> dict[str, list[dict]]:
    """Group the cells by their ablation, in order."""
    return {name: [c for c in cells if c["rung"] == name] for name in dict.fromkeys(c["rung"] for c in cells)}


def _judges(cells: Sequence[dict]) -> dict[tuple[str, ...], list[str]]:
    """Group the judged detectors by their surrogates."""
    found: dict[tuple[str, ...], list[str]] = {}
    for cell in cells:
        found.setdefault(tuple(cell["surrogates"]), []).append(cell["judged"])
    return found


def heat_map(cells: Sequence[dict]) -> Figure:
    """Plot success at 0.6 of every ablation by every judged detector, and below it the controls on the same images.

    A single ablation is also shown at the other thresholds. The last column is the mean.
    """
    judged, rows = list(dict.fromkeys(cell["judged"] for cell in cells)), {}
    ladder, last = by_ablation(cells), {cell["judged"]: cell for cell in cells}
    kinds = {"": " at 0.6", "_own": " at its own", "_025": " at 0.25"} if len(ladder) == 1 else {"": ""}
    for ablation, own in ladder.items():
        for suffix, words in kinds.items():
            found = {cell["judged"]: cell[f"success{suffix}"] for cell in own}
            rows[ablation + words] = [found.get(name) for name in judged]
    for control in ("random", CLOTHING):
        rows[SERIES[control].label] = [last[name][control] for name in judged]
    columns = [*(short_name(name) + MARKS[last[name]["kin"]] for name in judged), "mean"]
    figure = plots.heat_map(heat_values(rows), list(rows), columns, rule=len(rows) - 2)
    (axis,) = figure.axes
    axis.axvline(len(columns) - 1.5, color="white", lw=3)
    axis.set_xlabel("judged by (left out of training)")
    return figure
