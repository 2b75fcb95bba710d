"""The leave-one-out matrix: cloaks trained without a detector, judged by it.

A cell is an ablation (how was trained) and a judged detector; its record lies in OUT/cells, its trainings and
evaluations where a RunStore keeps them. So several calls, days or processes fill one matrix, and each does only what
is missing.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Int64

from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.evaluation.controls import STANDARD
from cloak_core.core.logo import area_share
from cloak_core.files.errors import InputError, Stopped
from cloak_core.files.reading import read_json
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import remove_leftovers, write_json, written
from cloak_core.studies.report.charts import group
from cloak_core.studies.report.page import write_page
from cloak_core.studies.report.plots import transfer_map
from cloak_core.studies.report.style import save_figure, style
from cloak_core.studies.report.words import file_name, percent, short_name
from cloak_core.studies.statistics_card import KINSHIPS, transfer_means, transfer_record
from cloak_core.studies.store import RunStore, Trained, training_times

FORMAT = "cloak transfer 1"


# --- which detectors are of one family

SAME_FAMILY, CROSS_FAMILY = KINSHIPS
_FAMILIES = {
    "yolo": "yolo",
    "rtdetr": "detr",
    "rt-detr": "detr",
    "detr": "detr",
    "d-fine": "detr",
    "dfine": "detr",
    "rcnn": "rcnn",
    "d2go": "rcnn",
}
"""By what a name holds, the first that fits: all YOLOs are of one family, whoever made them."""


def family_of(spec: str) -> str:
    """Read a detector's family from its spec: darknet:yolov3.cfg:... -> "yolo", onnx:nanodet_m.onnx -> "nanodet"."""
    name = short_name(spec).lower()
    for part, family in _FAMILIES.items():
        if part in name:
            return family
    last = name.split(" @")[0].rpartition(" ")[2]
    return (re.match(r"[a-z]+", last) or re.match(r".*", last))[0]


def families(specs: Iterable[str], told: Iterable[str] = ()) -> dict[str, str]:
    """Find each detector's family by its spec; `told` are NAME=FAMILY, NAME a part of a spec.

    InputError: not so spelled, or no spec has it.
    """
    found = {spec: family_of(spec) for spec in specs}
    for words in told:
        name, mark, family = words.rpartition("=")
        meant = [spec for spec in found if name in spec]
        if not (name and mark and family and meant):
            raise InputError(f"--kin {words}: expected PART_OF_A_SPEC=FAMILY, of the detectors that are given")
        found |= dict.fromkeys(meant, family)
    return found


def kinship(judged: str, surrogates: Iterable[str], family: Mapping[str, str]) -> str:
    """Tell whether a surrogate is of the judged detector's family: `SAME_FAMILY` or `CROSS_FAMILY`."""
    return SAME_FAMILY if family[judged] in {family[spec] for spec in surrogates} else CROSS_FAMILY


# --- ablations: from preset `best` to the recipe, each technique alone, and one upon the other

LADDER: dict[str, dict[str, object]] = {
    "smooth": {"smooth": 8},
    "animal": {"initial": "animal"},
    "window": {"crop": 0.15, "pad": 0.3},
    "adaptive": {"ensemble": "adaptive"},
    "cutout": {"cutout": 0.3},
    "quality": {"blur": 1.0, "jpeg": "50:95"},
    "shake": {"shake": 0.3},
    "depth": {"random_depth": 0.1},
    "noise": {"activation_noise": 0.1},
    "colour": {"tint": 0.2},
    "background": {"background_mix": 0.3},
    "sharpness": {"sharpness": 0.02, "ascent": "momentum"},
    "mi": {"optimizer": "mi", "momentum": 0.9, "lr": 0.02},
    "views": {"angles": "-20..20", "elevation": "0:20", "distance": "1.8:3.5"},
}
"""What each ablation changes of preset `best`, in order; up to `cutout` they are the recipe."""
ALONE: dict[str, dict[str, object]] = {"score": {"loss": "score"}}
"""Ablations that are no step of the ladder: steps back from `best`."""
BASE, RECIPE, ALL = "best", "recipe", "ladder"


def ablation_names(asked: Sequence[str]) -> tuple[str, ...]:
    """List the ablations' names, `ladder` spelled out. InputError: no such ablation."""
    whole = (BASE, *ALONE, *LADDER, *(f"+{name}" for name in list(LADDER)[1:]), RECIPE)
    found = tuple(dict.fromkeys(name for one in asked for name in (whole if one == ALL else (one,))))
    for name in found:
        if name not in whole:
            known = ", ".join((BASE, *ALONE, *LADDER, RECIPE, ALL))
            raise InputError(f"--rungs: {name!r} is not one of {known}; +NAME is all up to NAME")
    return found


def ablation_settings(name: str, photographs: bool = False) -> dict[str, object]:
    """Make the training settings of `best`, a technique alone upon it, +NAME (all up to it), or `recipe`.

    photographs: whether training sees people in photographs, for whom the recipe is another.
    """
    if name == RECIPE:
        return {"preset": "photographs" if photographs else "transfer"}
    settings: dict[str, object] = {"preset": "best"}
    if not name.startswith("+"):
        return settings | (LADDER | ALONE).get(name, {})
    steps = list(LADDER)
    for step in steps[: steps.index(name[1:]) + 1]:
        settings |= LADDER[step]
    return settings


# --- cameras


@dataclass(frozen=True)
class Cameras:
    """Where cameras stand, in training and in the test."""

    training: Mapping[str, object]
    """Training settings by name."""
    angles: tuple[float, ...]
    """Test azimuths, degrees."""
    test: Mapping[str, object]
    """Further evaluation settings by name."""


FRONT = Cameras({"angles": "-10:10:5", "elevation": 6, "distance": 2.2}, tuple(map(float, range(-10, 11, 4))), {})
PHOTOGRAPHS = Cameras({}, (), {})
"""Photographs stand where they were taken, and the recipe for them says where cameras of renders stand."""
CIRCLE = Cameras(
    {"angles": "0..360", "elevation": "0:30", "distance": "1.4:6"},
    tuple(map(float, range(0, 360, 10))),
    {"elevations": (0.0, 15.0, 30.0), "distances": (1.4, 2.2, 4.0, 6.0)},
)


# --- the matrix


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


def show(cells: Sequence[dict], folder: Path, name: str, command: str = "") -> list[Path]:
    """Write NAME.png, NAME.svg and NAME.md into the folder: the heat map, and tables for documentation."""
    folder.mkdir(parents=True, exist_ok=True)
    ladder = group(cells, "rung")
    with style():
        files = save_figure(transfer_map(ladder), folder / name)
    values = {
        "name": name,
        "cells": cells,
        "seeds": max(len(cell["by_seed"]) for cell in cells),
        "ladder": [(ablation, own, summary(own), _judges(own)) for ablation, own in ladder.items()],
        "command": without_folders(command),
    }
    return [*files, write_page(folder / f"{name}.md", "transfer.md", values)]


def _judges(cells: Sequence[dict]) -> dict[tuple[str, ...], list[str]]:
    """Group the judged detectors by their surrogates."""
    found: dict[tuple[str, ...], list[str]] = {}
    for cell in cells:
        found.setdefault(tuple(cell["surrogates"]), []).append(cell["judged"])
    return found
