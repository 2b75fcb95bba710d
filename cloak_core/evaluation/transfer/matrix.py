"""The leave-one-out matrix: cloaks trained without a detector, judged by it.

A cell is an ablation (how was trained) and a judged detector; its record lies in OUT/cells, its trainings and
evaluations where a RunStore keeps them. So several calls, days or processes fill one matrix, and each does only what
is missing.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Int64
from matplotlib.figure import Figure

from cloak_core.detectors.protocol import state_hash
from cloak_core.evaluation.controls import CLOTHING, STANDARD
from cloak_core.evaluation.report import plots
from cloak_core.evaluation.report.page import write_page
from cloak_core.evaluation.report.style import SERIES, save_figure, style
from cloak_core.evaluation.report.words import file_name, percent, short_name
from cloak_core.evaluation.statistics_card import heat_values, transfer_means, transfer_record
from cloak_core.evaluation.store import RunStore, Trained, training_times
from cloak_core.evaluation.transfer.plan import (
    ALL,
    CROSS_FAMILY,
    SAME_FAMILY,
    Cameras,
    ablation_names,
    ablation_settings,
    kinship,
)
from cloak_core.files.errors import InputError, Stopped
from cloak_core.files.reading import read_json
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import remove_leftovers, write_json, written
from cloak_core.scene.logos.logo import area_share

FORMAT = "cloak transfer 1"


@dataclass(frozen=True, eq=False)
class Matrix:
    """What is trained on which detectors, and judged by which."""

    store: RunStore
    faces: Int64[np.ndarray, " L"]
    logo: str
    """The logo's name."""
    surrogates: tuple[str, ...]
    judges: tuple[str, ...]
    family: Mapping[str, str]
    """By spec."""
    cameras: Cameras
    cross_family_only: bool = False
    """Detectors of a judged one's family are no surrogates for it."""
    deadline: float | None = None
    """On time.monotonic's clock: a training that is going on then stops in order."""

    def fill(self, asked: Sequence[str]) -> None:
        """Make every judged detector's cell of each of these ablations.

        Stopped: the time is over; the same call goes on from there. InputError: a judged detector has no surrogate.
        """
        for judged in self.judges:
            self.surrogates_for(judged)
        for ablation in ablation_names(asked):
            for judged in self.judges:
                cell = self.cell(ablation, judged)
                folder = self.store.options.out / "cells"
                with written(folder):
                    folder.mkdir(parents=True, exist_ok=True)
                file = folder / f"{ablation}--{file_name(judged)}.json"
                remove_leftovers(file)
                write_json(file, cell)
                self.store.tell(f"{ablation}: {short_name(judged)} ({cell['kin']}) {percent(cell['success'])}")

    def groups(self) -> list[tuple[str, ...]]:
        """Group the judged detectors by their surrogates: those together share all trainings."""
        found: dict[tuple[str, ...], list[str]] = {}
        for judged in self.judges:
            found.setdefault(self.surrogates_for(judged), []).append(judged)
        return [tuple(group) for group in found.values()]

    def surrogates_for(self, judged: str) -> tuple[str, ...]:
        """List the surrogates that are not the judged network, at any input size, nor (if asked) of its family."""
        detectors = self.store.split.detectors
        own = state_hash(detectors[judged])
        kept = [spec for spec in self.surrogates if spec != judged and state_hash(detectors[spec]) != own]
        if self.cross_family_only:
            kept = [spec for spec in kept if self.family[spec] != self.family[judged]]
        if not kept:
            raise InputError(f"--detector: none is left to train on without {judged}; name several")
        return tuple(kept)

    def cell(self, ablation: str, judged: str) -> dict:
        """Train an ablation without one detector and let it judge: plain values."""
        surrogates = self.surrogates_for(judged)
        settings = dict(self.cameras.training) | ablation_settings(ablation, self.store.split.people is not None)
        trained = [self._trained(surrogates, seed, settings) for seed in self.store.options.seed_list]
        test = {"controls": STANDARD} | self.cameras.test
        results = self.store.evaluate(trained, self.cameras.angles, [judged], **test)
        label = {"format": FORMAT, "rung": ablation, "judged": judged, "surrogates": list(surrogates)}
        label |= {"kin": kinship(judged, surrogates, self.family), "strangers_only": self.cross_family_only}
        split, made = self.store.split, trained[0].settings
        label |= {"settings": settings, "steps": made.total_steps(len(split.backgrounds)), "batch": made.run.batch}
        label |= {"logo": self.logo, "area_share": round(area_share(split.bodies, self.faces), 4)}
        return label | transfer_record(results, judged) | training_times(trained) | {"materials": split.record()}

    def _trained(self, surrogates: tuple[str, ...], seed: int, settings: dict) -> Trained:
        left = {} if self.deadline is None else {"max_seconds": self.deadline - time.monotonic()}
        if left and left["max_seconds"] <= 0:
            raise Stopped("the time budget is spent; the same command goes on with what is left")
        return self.store.train(self.faces, surrogates, seed=seed, **settings, **left)


def gather(out: Path) -> list[dict]:
    """Read every cell that OUT holds, in the order of the ladder. InputError: none, or none of this format."""
    cells = [read_json(path) for path in sorted((out / "cells").glob("*.json"))]
    if not cells:
        raise InputError(f"{out}: holds no cell of a transfer matrix")
    for cell in cells:
        if cell.get("format") != FORMAT:
            said = f"a cell of another version ({cell.get('format')}); this one has {FORMAT}"
            raise InputError(f"{out / 'cells'}: {said}")
    order = {name: place for place, name in enumerate(ablation_names((ALL,)))}
    return sorted(cells, key=lambda cell: (order.get(cell["rung"], len(order)), cell["rung"], cell["judged"]))


def summary(cells: Sequence[dict]) -> dict:
    """Make what `cloak transfer --json` prints of the cells of one ablation."""
    shown = ("surrogates", "success", "success_own", "success_025", "ci95", "ci95_own", "ci95_025", "random")
    shown += ("clothing", "grey", "random_025", "n", "kin", "by_seed", "operating_point", "steps", "seconds")
    shown += ("renamed", "renamed_own", "gone", "gone_own", "named")  # earlier versions' cells do not tell
    matrix = {cell["judged"]: {key: cell.get(key) for key in shown} for cell in cells}
    return {"matrix": matrix} | transfer_means(pd.DataFrame(cells))


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
