"""What an experiment is going to do: its rows by name, how many updates and images each takes, and about how long."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from cloak_core.experiments.declaration import Cell, Experiment, test_angles
from cloak_core.files.errors import InputError
from cloak_core.studies.pace import Pace, measured_pace
from cloak_core.studies.report.charts import Rows
from cloak_core.studies.store import RunStore


@dataclass(frozen=True)
class Row:
    """One row of an experiment's table, before it is made."""

    number: int
    """From 1."""
    name: str
    updates: int
    """Of the colours, over all repetitions."""
    seconds: float
    """About how long it takes, by the detector's measured pace."""


def row_name(cell: Cell) -> str:
    """Name a cell by what its rows are labelled with, and the detectors that it is trained against."""
    label = [str(value) for value in cell.label.values()]
    return ", ".join([*label, *cell.specs]) or "the only row"


def plan(experiment: Experiment, store: RunStore) -> list[Row]:
    """List an experiment's rows. InputError: it has none, for it measures in a way of its own."""
    paces = {spec: measured_pace(detector, store.options.size) for spec, detector in store.split.detectors.items()}
    return [_row(number, cell, store, paces) for number, cell in enumerate(_cells(experiment, store), 1)]


def chosen(experiment: Experiment, store: RunStore, only: Sequence[str]) -> list[Cell]:
    """Choose rows by their numbers, or by words of their names. InputError: one names no row."""
    cells = _cells(experiment, store)
    names = [row_name(cell) for cell in cells]
    found: dict[int, Cell] = {}
    for asked in only:
        numbers = [int(asked) - 1] if asked.isdigit() else [k for k, name in enumerate(names) if asked in name]
        if not numbers or not 0 <= numbers[0] < len(cells):
            rows = "; ".join(f"{k} {name}" for k, name in enumerate(names, 1))
            raise InputError(f"--only {asked}: no such row ({rows})")
        found |= {number: cells[number] for number in numbers}
    return [found[number] for number in sorted(found)]


def paper_rows(experiment: Experiment, rows: Rows) -> Rows:
    """Select the paper's rows that any of these stand beside: they agree in all that both name but the detector."""
    labels = [
        {key: value for key, value in told.items() if key != "detector" and isinstance(value, str)}
        for told in experiment.paper
    ]
    agrees = lambda label, row: all(row.get(key, value) in (value, "all") for key, value in label.items())
    beside = [any(agrees(label, row) for row in rows) for label in labels]
    return [dict(told) for told, stands in zip(experiment.paper, beside, strict=True) if stands]


def _cells(experiment: Experiment, store: RunStore) -> list[Cell]:
    if experiment.measure:
        raise InputError(f"{experiment.title}: measures in a way of its own, without rows that could be chosen")
    return list(experiment.cells(store))


def _row(number: int, cell: Cell, store: RunStore, paces: dict[str, Pace]) -> Row:
    specs = cell.specs or store.specs[:1]
    judges = cell.judges or specs
    updates = batch = 0
    if cell.pattern is None:
        changes = {key: value for key, value in cell.training.items() if key != "bodies"}
        settings = store.train_settings(store.options.seed, specs, **changes)
        updates = len(store.options.seed_list) * settings.total_steps(len(store.split.backgrounds))
        batch = settings.run.batch
    training = updates * batch * _sum(paces, specs, "gradient")
    images = _images(cell, store) * (len(store.options.seed_list) if updates else 1)
    return Row(number, row_name(cell), updates, training + images * _sum(paces, judges, "forward"))


def _images(cell: Cell, store: RunStore) -> int:
    """Count the images that judge one training, under every control."""
    changes = {key: value for key, value in cell.test.items() if key != "bodies"}
    settings = store.evaluate_settings(**changes)
    views = store.split.unseen.pose_count * len(cell.angles or test_angles(store)) * settings.images_per_view
    return min(views, settings.most_images or views) * (1 + len(settings.controls))


def _sum(paces: dict[str, Pace], specs: Iterable[str], name: str) -> float:
    # Detectors of a store of the cell's own were not timed: they count as the slowest.
    slowest = max(getattr(pace, name) for pace in paces.values())
    return sum(getattr(paces[spec], name) if spec in paces else slowest for spec in specs)
