"""The leave-one-out matrix: a training without the judged detector, and what the judged one says of it.

A cell is a rung (how was trained) and a judged detector; its record lies in OUT/cells, its trainings and evaluations
where a Lab keeps them. So several calls, days or processes fill one matrix, and each does only what is missing.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cloak_core.attack.run_config import device_kind
from cloak_core.detectors import THRESHOLD
from cloak_core.detectors.protocol import state_hash
from cloak_core.evaluation.controls import LOGO, STANDARD
from cloak_core.evaluation.experiments.lab import MEASURING, Interrupted, Lab, Trained, times
from cloak_core.evaluation.experiments.repeats import Repeats, rounded
from cloak_core.evaluation.leave_one_out import rungs
from cloak_core.evaluation.leave_one_out.kin import kin
from cloak_core.evaluation.report.words import file_name, percent, short_name
from cloak_core.files.errors import InputError
from cloak_core.files.identity import TRAINING, code_hash, sha256_record
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json, written
from cloak_core.scene.logos.logo import area_share

FORMAT = "cloak transfer 1"
LOW = 0.25
"""The threshold at which YOLOv5 and later are run."""


@dataclass(frozen=True)
class Places:
    """Where cameras stand, in training (by the names of training settings) and in the test."""

    training: Mapping[str, object]
    angles: tuple[float, ...]
    """Test azimuths, degrees."""
    test: Mapping[str, object]
    """Further settings of the evaluation, by name."""

    def with_training(self, **changes: object) -> Places:
        """The same with more training settings."""
        return replace(self, training=dict(self.training) | changes)

    def with_test(self, **changes: object) -> Places:
        """The same with more settings of the evaluation."""
        return replace(self, test=dict(self.test) | changes)


FRONT = Places({"angles": "-10:10:5", "elevation": 6, "distance": 2.2}, tuple(map(float, range(-10, 11, 4))), {})
CIRCLE = Places(
    {"angles": "0..360", "elevation": "0:30", "distance": "1.4:6"},
    tuple(map(float, range(0, 360, 10))),
    {"elevations": (0.0, 15.0, 30.0), "distances": (1.4, 2.2, 4.0, 6.0)},
)


class LastingLab(Lab):
    """A lab whose trainings keep their names when the code changes: a matrix takes days, and a cell says by which code
    it was trained. Evaluations, quickly made again, keep theirs as long as rendering and measuring do."""

    def _key(self, record: dict, code: Sequence[str]) -> str:
        measuring = [part for part in code if part != "attack"] if tuple(code) == MEASURING else []
        around = {"device": device_kind(self.options.device)} | ({"code": code_hash(*measuring)} if measuring else {})
        try:
            return sha256_record(record | around)[:16]
        except ValueError as error:
            raise InputError(f"settings: {error}") from None


@dataclass(frozen=True, eq=False)
class Matrix:
    """What is trained on which detectors, and judged by which."""

    lab: LastingLab
    faces: np.ndarray
    logo: str
    """What the logo is called."""
    surrogates: tuple[str, ...]
    judges: tuple[str, ...]
    family: Mapping[str, str]
    """By spec."""
    places: Places
    strangers_only: bool = False
    """A judged detector's siblings are no surrogates for it."""
    deadline: float | None = None
    """On time.monotonic's clock: the training that goes on then stops in order."""

    def fill(self, asked: Sequence[str]) -> None:
        """Every judged detector's cell of each of these rungs. Interrupted where the time is over: the same call goes
        on from there. InputError: a judged detector has no surrogate."""
        for judged in self.judges:
            self.surrogates_for(judged)
        for rung in rungs.names(asked):
            for judged in self.judges:
                cell = self.cell(rung, judged)
                folder = self.lab.options.out / "cells"
                with written(folder):
                    folder.mkdir(parents=True, exist_ok=True)
                write_json(folder / f"{rung}--{file_name(judged)}.json", cell)
                self.lab.tell(f"{rung}: {short_name(judged)} ({cell['kin']}) {percent(cell['success'])}")

    def groups(self) -> list[tuple[str, ...]]:
        """The judged detectors; those together whose surrogates, and so whose trainings, are the same."""
        found: dict[tuple[str, ...], list[str]] = {}
        for judged in self.judges:
            found.setdefault(self.surrogates_for(judged), []).append(judged)
        return [tuple(group) for group in found.values()]

    def surrogates_for(self, judged: str) -> tuple[str, ...]:
        """All that are not the judged network itself, at whatever input size, nor (if asked) of its family."""
        detectors = self.lab.materials.detectors
        own = state_hash(detectors[judged])
        kept = [spec for spec in self.surrogates if spec != judged and state_hash(detectors[spec]) != own]
        if self.strangers_only:
            kept = [spec for spec in kept if self.family[spec] != self.family[judged]]
        if not kept:
            raise InputError(f"--detector: none is left to train on without {judged}; name several")
        return tuple(kept)

    def cell(self, rung: str, judged: str) -> dict:
        """One rung trained without one detector, judged by it: plain values."""
        surrogates = self.surrogates_for(judged)
        settings = dict(self.places.training) | rungs.changes(rung)
        trained = [self._trained(surrogates, seed, settings) for seed in self.lab.options.seed_list]
        test = {"controls": STANDARD} | self.places.test
        result = self.lab.evaluate(trained, self.places.angles, [judged], **test)
        label = {"format": FORMAT, "rung": rung, "judged": judged, "surrogates": list(surrogates)}
        label |= {"kin": kin(judged, surrogates, self.family), "strangers_only": self.strangers_only}
        point = self.lab.materials.detectors[judged].operating_point
        return label | rates(result, judged, point) | self._circumstances(trained, settings)

    def _trained(self, surrogates: tuple[str, ...], seed: int, settings: dict) -> Trained:
        left = {} if self.deadline is None else {"max_seconds": self.deadline - time.monotonic()}
        if left and left["max_seconds"] <= 0:
            raise Interrupted("the time budget is spent; the same command goes on with what is left")
        return self.lab.train(self.faces, surrogates, seed=seed, **settings, **left)

    def _circumstances(self, trained: Sequence[Trained], settings: dict) -> dict:
        materials, code = self.lab.materials, {str(read_json(t.folder / "config.json").get("code")) for t in trained}
        return {
            "settings": settings,
            "steps": trained[0].settings.total_steps(len(materials.backgrounds)),
            "batch": trained[0].settings.run.batch,
            **times(trained),
            "code": sorted(code),
            "code_now": code_hash(*TRAINING),
            "logo": self.logo,
            "area_share": round(area_share(materials.bodies, self.faces), 4),
            "materials": materials.record(),
        }


def rates(result: Repeats, judged: str, point: float) -> dict:
    """Success at 0.6, at the detector's own operating point and at 0.25, each with its interval and the controls."""
    row: dict[str, object] = {}
    for suffix, threshold in (("", THRESHOLD), ("_own", point), ("_025", LOW)):
        rate = result.rate(judged, threshold=threshold)
        row |= rounded({f"success{suffix}": rate.value})
        row[f"ci95{suffix}"] = list(rounded({"low": rate.low, "high": rate.high}).values())
        controls = {f"{name}{suffix}": result.rate(judged, name, threshold=threshold).value for name in STANDARD}
        row |= rounded(controls)
    d = result.specs.index(judged)
    by_seed = [float((m.score[d, m.controls.index(LOGO)] <= THRESHOLD).mean()) for m in result.measurements]
    more = {"operating_point": point, "n": len(result.trials) * len(by_seed), "images": len(result.trials)}
    return row | more | {"by_seed": [round(value, 4) for value in by_seed]}


def gather(out: Path) -> list[dict]:
    """Every cell that OUT holds, in the order of the ladder. InputError: none, or none of this format."""
    cells = [read_json(path) for path in sorted((out / "cells").glob("*.json"))]
    if not cells:
        raise InputError(f"{out}: holds no cell of a transfer matrix")
    for cell in cells:
        if cell.get("format") != FORMAT:
            raise InputError(
                f"{out / 'cells'}: a cell of another version ({cell.get('format')}); this one has {FORMAT}"
            )
    order = {name: place for place, name in enumerate(rungs.names((rungs.ALL,)))}
    return sorted(cells, key=lambda cell: (order.get(cell["rung"], len(order)), cell["rung"], cell["judged"]))


def summary(cells: Sequence[dict]) -> dict:
    """What `cloak transfer --json` prints of the cells of one rung."""
    shown = ("surrogates", "success", "success_own", "success_025", "ci95", "ci95_own", "ci95_025", "random")
    shown += ("clothing", "grey", "random_025", "n", "kin", "by_seed", "operating_point", "steps", "seconds")
    found = {"matrix": {cell["judged"]: {key: cell[key] for key in shown} for cell in cells}}
    for suffix in ("", "_own", "_025"):
        values = [cell[f"success{suffix}"] for cell in cells]
        found |= rounded({f"mean{suffix}": float(np.mean(values)), f"worst{suffix}": float(min(values))})
    for name in ("sibling", "stranger"):
        own = [cell["success"] for cell in cells if cell["kin"] == name]
        found[f"mean_{name}"] = round(float(np.mean(own)), 4) if own else None
    return found
