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
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Int64

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.evaluation import LOGO, STANDARD
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.statistics import (
    by_training,
    digits,
    hidden_rate,
    operating_point,
    outcome_record,
    rate_record,
    success_rate,
)
from cloak_core.core.logo import area_share
from cloak_core.core.source import NOBODY, Cast
from cloak_core.files.errors import InputError, Stopped
from cloak_core.files.identity import sha256_record
from cloak_core.files.reading import read_json
from cloak_core.files.writing import remove_leftovers, write_json, written
from cloak_core.studies.pace import in_turn, measured_pace
from cloak_core.studies.report.charts import group, publish_rows
from cloak_core.studies.report.plots import KINSHIPS, transfer_map
from cloak_core.studies.report.style import save_figure, style
from cloak_core.studies.report.words import file_name, percent, short_name
from cloak_core.studies.store import RunStore
from cloak_core.studies.training_store import training_times

FORMAT = "cloak transfer 1"
LOW = 0.25
"""The threshold at which YOLOv5 and later are run."""


# --- which detectors are of one family

_FAMILIES = {
    "yolo": "yolo",
    "detr": "detr",
    "d-fine": "detr",
    "dfine": "detr",
    "rcnn": "rcnn",
    "d2go": "rcnn",
}
"""By what a name holds, the first that fits: all YOLOs are of one family, whoever made them."""


def families(specs: Iterable[str], overrides: Iterable[str] = ()) -> dict[str, str]:
    """Find each detector's family by its spec: darknet:yolov3.cfg:... -> "yolo", onnx:nanodet_m.onnx -> "nanodet".

    `overrides` are NAME=FAMILY, NAME a part of a spec. InputError: not so spelled, or no spec has it.
    """
    family_by_spec = {}
    for spec in specs:
        name = short_name(spec).lower()
        last = name.split(" @")[0].rpartition(" ")[2]
        known = (family for part, family in _FAMILIES.items() if part in name)
        family_by_spec[spec] = next(known, re.match(r"[a-z]*", last)[0] or last)
    for override in overrides:
        name, mark, family = override.rpartition("=")
        matching = [spec for spec in family_by_spec if name in spec]
        if not (name and mark and family and matching):
            raise InputError(f"--kin {override}: expected PART_OF_A_SPEC=FAMILY, of the detectors that are given")
        family_by_spec |= dict.fromkeys(matching, family)
    return family_by_spec


def kinship(judged: str, surrogates: Iterable[str], family: Mapping[str, str]) -> str:
    """Tell whether a surrogate is of the judged detector's family, by one of `KINSHIPS`."""
    sibling, stranger = KINSHIPS
    return sibling if family[judged] in {family[spec] for spec in surrogates} else stranger


# --- ablations: from preset `best` to the recipe, each technique alone, and one upon the other

LADDER: dict[str, dict[str, object]] = {
    "smooth": {"smooth": 8},
    "animal": {"initial": "animal"},
    "window": {"crop": 0.15, "pad": 0.3},
    "adaptive": {"ensemble": "adaptive"},
    "cutout": {"cutout": 0.3},
    "blur": {"blur": 1.0},
    "shake": {"shake": 0.3},
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
    names = [name for word in asked for name in (whole if word == ALL else (word,))]
    for name in names:
        if name not in whole:
            known = ", ".join((BASE, *ALONE, *LADDER, RECIPE, ALL))
            raise InputError(f"--rungs: {name!r} is not one of {known}; +NAME is all up to NAME")
    return tuple(dict.fromkeys(names))


def ablation_settings(name: str, people: Cast = NOBODY) -> dict[str, object]:
    """Make the training settings of `best`, a technique alone upon it, +NAME (all up to it), or `recipe`.

    people: whom training sees beside bodies, for whom the recipe may be another.
    """
    if name == RECIPE:
        return {"preset": people.preset("transfer")}
    settings: dict[str, object] = {"preset": "best"}
    if not name.startswith("+"):
        return settings | (LADDER | ALONE).get(name, {})
    for step, changes in LADDER.items():
        settings |= changes
        if step == name[1:]:
            break
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
class TransferMatrix:
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
        cells = list(product(ablation_names(asked), self.judges))
        name = lambda cell: f"{cell[0]}, judged by {short_name(cell[1])}"
        for ablation, judged in in_turn(cells, name, self.store.tell):
            cell = self.cell(ablation, judged)
            # Detectors may share a short name, so that the hash of the spec is part of the file's.
            file = self.store.out / "cells" / f"{ablation}--{file_name(judged)}-{sha256_record(judged)[:6]}.json"
            with written(file.parent):
                file.parent.mkdir(parents=True, exist_ok=True)
            remove_leftovers(file)
            write_json(file, cell)
            self.store.tell(f"{ablation}: {short_name(judged)} ({cell['kin']}) {percent(cell['success'])}")

    def work(self, asked: Sequence[str]) -> tuple[int, float]:
        """Count the trainings of these ablations, and about how many seconds they take where none is done yet."""
        split, seeds = self.store.split, len(self.store.options.seed_list)
        paces = {
            spec: measured_pace(split.detectors[spec], self.store.options.size).gradient for spec in self.surrogates
        }
        count, seconds = 0, 0.0
        for ablation, judges in product(ablation_names(asked), self.groups()):
            surrogates = self.surrogates_for(judges[0])
            settings = self.store.train_settings(specs=surrogates, **self._settings(ablation))
            images = settings.total_steps(len(split.backgrounds)) * settings.run.batch
            asked_at_once = (settings.objective.detectors_per_step or len(surrogates)) / len(surrogates)
            count += seeds
            seconds += seeds * images * asked_at_once * sum(paces[spec] for spec in surrogates)
        return count, seconds

    def _settings(self, ablation: str) -> dict[str, object]:
        return dict(self.cameras.training) | ablation_settings(ablation, self.store.split.people)

    def groups(self) -> list[tuple[str, ...]]:
        """Group the judged detectors by their surrogates: those together share all trainings."""
        judges: dict[tuple[str, ...], list[str]] = {}
        for judged in self.judges:
            judges.setdefault(self.surrogates_for(judged), []).append(judged)
        return list(map(tuple, judges.values()))

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
        surrogates, split, settings = self.surrogates_for(judged), self.store.split, self._settings(ablation)
        trained = []
        for seed in self.store.options.seed_list:
            limit = {} if self.deadline is None else {"max_seconds": self.deadline - time.monotonic()}
            if limit and limit["max_seconds"] <= 0:
                raise Stopped("the time budget is spent; the same command goes on with what is left")
            trained.append(self.store.train_faces(self.faces, surrogates, seed=seed, **settings, **limit))
        test = {"controls": STANDARD} | self.cameras.test
        results = self.store.measure_repetitions(trained, self.cameras.angles, [judged], **test)
        complete = trained[0].settings
        return {
            "format": FORMAT,
            "rung": ablation,
            "judged": judged,
            "surrogates": list(surrogates),
            "kin": kinship(judged, surrogates, self.family),
            "strangers_only": self.cross_family_only,
            "settings": settings,
            "steps": complete.total_steps(len(split.backgrounds)),
            "batch": complete.run.batch,
            "logo": self.logo,
            "area_share": round(area_share(split.bodies, self.faces), 4),
            **transfer_record(results, judged),
            **training_times(trained),
            "materials": split.record(),
        }


# --- its figures


def transfer_record(results: Results, judged: str) -> dict:
    """Count a cell: success at 0.6, at the detector's own threshold and at 0.25, with intervals and controls."""
    rows, record = results.rows(judged, LOGO), {}
    point = operating_point(rows)
    for suffix, threshold in (("", THRESHOLD), ("_own", point), ("_025", LOW)):
        record |= rate_record(f"success{suffix}", hidden_rate(rows, threshold), 4)
        record |= {f"{name}{suffix}": digits(success_rate(results.rows(judged, name), threshold)) for name in STANDARD}
    record |= outcome_record(rows) | {"operating_point": point, "n": len(rows), "images": len(results.trials)}
    return record | {"by_seed": [digits(value) for value in by_training(rows)]}


# --- its files


def gather(out: Path) -> list[dict]:
    """Read every cell that OUT holds, in the order of the ladder. InputError: none, or none of this format."""
    cells: dict[tuple[str, str], dict] = {}
    for path in sorted((out / "cells").glob("*.json")):
        cell = read_json(path)
        if cell.get("format") != FORMAT:
            raise InputError(f"{path}: a cell of another version ({cell.get('format')}); this one has {FORMAT}")
        # Earlier versions named files without the hash. Such a file sorts behind the one that was made since.
        cells.setdefault((cell["rung"], cell["judged"]), cell)
    if not cells:
        raise InputError(f"{out}: holds no cell of a transfer matrix")
    order = {name: place for place, name in enumerate(ablation_names((ALL,)))}
    place = lambda cell: (order.get(cell["rung"], len(order)), cell["rung"], cell["judged"])
    return sorted(cells.values(), key=place)


def summary(cells: Sequence[dict]) -> dict:
    """Make what `cloak transfer --json` prints of the cells of one ablation: each, and mean and worst success."""
    shown = ("surrogates", "success", "success_own", "success_025", "ci95", "ci95_own", "ci95_025", "random")
    shown += ("clothing", "grey", "random_025", "n", "kin", "by_seed", "operating_point", "steps", "seconds")
    shown += ("renamed", "renamed_own", "gone", "gone_own", "named")  # earlier versions' cells do not tell
    matrix = {cell["judged"]: {key: cell.get(key) for key in shown} for cell in cells}
    table, means = pd.DataFrame(cells), {}
    for suffix in ("", "_own", "_025"):
        values = table[f"success{suffix}"].astype(float)
        means |= {f"mean{suffix}": digits(values.mean()), f"worst{suffix}": digits(values.min())}
    means |= {f"mean_{kin}": digits(table.loc[table["kin"] == kin, "success"].mean()) for kin in KINSHIPS}
    return {"matrix": matrix} | means


def show(cells: Sequence[dict], folder: Path, name: str) -> list[Path]:
    """Write the heat map into the folder: NAME.png and NAME.svg."""
    folder.mkdir(parents=True, exist_ok=True)
    with style():
        return save_figure(transfer_map(group(cells, "rung")), folder / name)


def publish(cells: Sequence[dict], folder: Path, table: str, study: str, command: str) -> Path:
    """Put a row for each cell into FOLDER/TABLE.csv as a study; returns the file.

    A row has None for what an earlier version's cell does not tell.
    """
    rows = []
    for cell in cells:
        row = {"rung": cell["rung"], "judged": short_name(cell["judged"]), "kin": cell["kin"]}
        for rate, interval in (("success", "ci95"), ("success_own", "ci95_own"), ("success_025", "ci95_025")):
            row |= {rate: cell[rate], f"{rate}_low": cell[interval][0], f"{rate}_high": cell[interval][1]}
        for key in ("operating_point", "renamed", "gone", "random", "clothing", "n", "cpu_seconds"):
            row[key] = cell.get(key)
        row["by_seed"] = "; ".join(map(str, cell["by_seed"]))
        row["surrogates"] = "; ".join(map(short_name, cell["surrogates"]))
        rows.append(row)
    steps = " / ".join(map(str, dict.fromkeys(cell["steps"] for cell in cells)))
    seeds = max(len(cell["by_seed"]) for cell in cells)
    made = {"command": command, "steps": steps, "seeds": seeds, "logo": cells[-1]["logo"]}
    return publish_rows(folder, table, study, rows, made)
