"""Run experiments: fill the table that a declaration asks for, keep it in a file, and draw it from that file."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import islice, product
from pathlib import Path

import pandas as pd

from cloak_core import __version__
from cloak_core.core.evaluation import CLOTHING, statistics
from cloak_core.core.evaluation.results import Results
from cloak_core.core.logo import area_share, chest_thighs
from cloak_core.core.pictures import save_picture
from cloak_core.exchange.bodies import Bodies
from cloak_core.experiments.declaration import MULTI, Cell, Experiment, Numbers, Trainings, test_angles
from cloak_core.experiments.options import EXPERIMENTS
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import remove_all_leftovers, write_json, write_text
from cloak_core.studies.pace import DetectorPace, in_turn, measured_pace
from cloak_core.studies.report.charts import Rows
from cloak_core.studies.report.style import save_figure, style
from cloak_core.studies.store import RunStore
from cloak_core.studies.training_store import Trained, training_times
from cloak_core.studies.trainings.run_record import environment

FORMAT = "cloak experiment 1"
"""Of numbers.json."""


@cache
def experiments() -> dict[str, Experiment]:
    """Load every declaration, by name, in the order in which `all` runs them."""
    places = {name: place.split(":") for name, place in EXPERIMENTS.items()}
    package = "cloak_core.experiments.declared"
    return {name: getattr(import_module(f"{package}.{module}"), word) for name, (module, word) in places.items()}


def run_experiment(name: str, store: RunStore) -> dict:
    """Run one experiment and write OUT/NAME; returns its record: rows, caption, figures, the paper's values.

    InputError: there is no such experiment. Stopped: a training was stopped in order; the same call continues it.
    """
    experiment = find(name)
    numbers = measure(experiment, store)
    remove_all_leftovers(store.options.out / name)
    write_numbers(store.options.out / name, name, numbers, store, experiment.counts(store))
    return draw_again(name, store.options.out)


def measure(experiment: Experiment, store: RunStore) -> Numbers:
    """Train and judge every cell of an experiment; rows over all images come first, then rows along a column."""
    if experiment.measure:
        return experiment.measure(store)
    whole: Rows = []
    along: Rows = []
    thresholds: Rows = []
    trainings: Trainings = []
    for cell, trained, results in _measured(store, experiment.cells(store)):
        trainings.append((cell, trained))
        for spec in _judges(cell, store):
            whole.append(_row(cell, store.split.bodies, trained, results, spec))
            if not cell.columns:
                thresholds += threshold_rows(whole[-1], results, spec)
            if cell.baseline is not None:
                rate = statistics.hidden_rate(results.rows(spec, CLOTHING))
                whole.append({**cell.baseline, "detector": spec} | statistics.rate_row(rate))
            if cell.along:
                along += _rows_along(cell, results, spec)
    steps = {spec: store.steps([spec], angles=MULTI) for spec in store.specs}
    facts = {"angles": len(test_angles(store)), "steps": steps, **experiment.facts}
    return Numbers(experiment.finish(whole + along), facts, thresholds, experiment.pictures(store, trainings))


def measure_rows(cells: Sequence[Cell], store: RunStore) -> Rows:
    """Train and judge some cells; their rows over all images, as an experiment's table has them."""
    return [
        _row(cell, store.split.bodies, trained, results, spec)
        for cell, trained, results in _measured(store, cells)
        for spec in _judges(cell, store)
    ]


def measure_part(experiment: Experiment, store: RunStore, part: int, of: int) -> None:
    """Train and judge every `of`-th cell from `part` on, for `measure` to find; an experiment without cells, whole."""
    if experiment.measure:
        if part == 0:
            experiment.measure(store)
        return
    for _ in _measured(store, islice(experiment.cells(store), part, None, of)):
        pass


def row_name(cell: Cell) -> str:
    """Name a cell by what its rows are labelled with, and the detectors that it is trained against."""
    label = [str(value) for value in cell.label.values()]
    return ", ".join([*label, *cell.specs]) or "the only row"


def _measured(store: RunStore, cells: Iterable[Cell]) -> Iterator[tuple[Cell, list[Trained], Results]]:
    """Train and judge cells, one after the other, and say how far this is."""
    for cell in in_turn(list(cells), row_name, store.tell):
        own = cell.store or store
        trained = _trained(cell, own)
        yield (
            cell,
            trained,
            own.measure_repetitions(trained, cell.angles or test_angles(store), _judges(cell, store), **cell.test),
        )


def _trained(cell: Cell, store: RunStore) -> list[Trained]:
    faces = chest_thighs(store.split.bodies) if cell.faces is None else cell.faces
    if cell.pattern is not None:
        return [store.untrained(cell.pattern)]
    training = dict(cell.training)
    if cell.begun:
        length = {"angles": MULTI, "steps": store.steps(cell.begun, angles=MULTI)}
        begun = store.train_faces(faces, cell.begun, seed=store.options.seed, **length)
        training["init"] = str(begun.folder)
    return store.train_repetitions(faces, cell.specs or store.specs[:1], **training)


def _judges(cell: Cell, store: RunStore) -> tuple[str, ...]:
    return tuple(cell.judges or cell.specs or store.specs[:1])


def _row(cell: Cell, bodies: Bodies, trained: list[Trained], results: Results, spec: str) -> dict:
    """Make the row of one judge over all images of a cell."""
    label = dict(cell.label)
    if cell.area:
        label["area_share"] = round(area_share(bodies, trained[0].pattern.cover.face_ids), 4)
    if cell.along:
        label[next(iter(cell.along))] = "all"
    label.setdefault(cell.judge_column, spec)
    if cell.timed:
        label |= training_times(trained)
    if not cell.columns:
        row = statistics.training_row(results, spec)
        return label | {key: value for key, value in row.items() if key != "detector"} | cell.extra(results, spec)
    row = statistics.operating_row(results, spec)
    columns = {key: row[key] for key in ("success", "low", "high", "n", *cell.columns)}
    return label | columns | cell.extra(results, spec)


def _rows_along(cell: Cell, results: Results, spec: str) -> Iterator[dict]:
    """Yield a row for each value of the columns in `cell.along`; the last column is the innermost."""
    *outer, inner = cell.along
    for values in product(*(cell.along[column] for column in outer)):
        where = dict(zip(outer, values, strict=True))
        for row in statistics.rows_at(results, spec, inner, cell.along[inner], **where):
            yield {**cell.label, **where} | row


def threshold_rows(row: dict, results: Results, spec: str) -> Rows:
    """Compute success at every threshold, a row for each control, under the label of a row of the table."""
    label = {key: row[key] for key in list(row)[: list(row).index("success")]}
    curves = {control: statistics.threshold_curve(results.rows(spec, control)) for control in results.controls}
    names = [f"at_{t:g}" for t in statistics.THRESHOLDS]
    return [
        label | {"control": control} | dict(zip(names, map(statistics.digits, curve), strict=True))
        for control, curve in curves.items()
    ]


def write_numbers(folder: Path, name: str, numbers: Numbers, store: RunStore, more_counts: dict) -> None:
    """Write what was measured into `folder`: numbers.json and .csv, thresholds.csv, pictures and config.json."""
    folder.mkdir(parents=True, exist_ok=True)
    for key, picture in numbers.pictures.items():
        save_picture(folder / f"{key}.jpg", picture.convert("RGB"), quality=85, optimize=True)
    for key, rows in {"numbers": numbers.rows, "thresholds": numbers.thresholds}.items():
        if rows:
            table = pd.DataFrame(rows, dtype=object)
            write_text(folder / f"{key}.csv", table.to_csv(index=False, lineterminator="\r\n"))
    counts = store.options.counts() | more_counts
    config = {"command": store.options.command} | counts | store.split.record() | {"cloak": __version__} | environment()
    config["date"] = time.strftime("%Y-%m-%d")
    write_json(folder / "config.json", config)
    measured = {"rows": numbers.rows, "thresholds": numbers.thresholds, "facts": numbers.facts, "counts": counts}
    pictures = [f"{key}.jpg" for key in numbers.pictures]
    write_json(folder / "numbers.json", {"format": FORMAT, "experiment": name, "pictures": pictures} | measured)


def draw_again(name: str, out: Path) -> dict:
    """Draw one experiment from OUT/NAME/numbers.json alone; returns its record.

    InputError: it was never run, or an unreadably early version ran it.
    """
    experiment = find(name)
    folder = out / name
    record = read_json(folder / "numbers.json")
    if record.get("format") != FORMAT:
        raise InputError(f"{folder / 'numbers.json'}: not a {FORMAT}; run the experiment again to draw its figures")
    with style():
        figures = {key: chart.draw(record["rows"], record["thresholds"]) for key, chart in experiment.figures.items()}
        files = [path.name for key, f in figures.items() if f for path in save_figure(f, folder / key)]
    record |= {"title": experiment.title, "paper": list(experiment.paper), "words": [experiment.caption]}
    record["figures"] = [*files, *record["pictures"]]
    write_json(folder / "numbers.json", record)
    return record


def find(name: str) -> Experiment:
    """Look up an experiment by its name. InputError: there is none."""
    if name not in experiments():
        raise InputError(f"experiment '{name}': not one of {', '.join(experiments())}, all")
    return experiments()[name]


def finished(out: Path) -> dict[str, dict]:
    """Read the records of the experiments that OUT holds, in order. InputError: there is none."""
    paths = {name: out / name / "numbers.json" for name in experiments()}
    records = {name: read_json(path) for name, path in paths.items() if path.exists()}
    drawn = {name: record for name, record in records.items() if "words" in record}
    if not drawn:
        raise InputError(f"{out}: holds no finished experiment")
    return drawn


# --- what an experiment is going to do, before it does it


@dataclass(frozen=True)
class Planned:
    """One row of an experiment's table, before it is made."""

    number: int
    """From 1."""
    name: str
    updates: int
    """Of the colours, over all repetitions."""
    seconds: float
    """About how long it takes, by the detector's measured pace."""


def plan(experiment: Experiment, store: RunStore) -> list[Planned]:
    """List an experiment's rows. InputError: it has none, for it measures in a way of its own."""
    paces = {spec: measured_pace(detector, store.options.size) for spec, detector in store.split.detectors.items()}
    return [_planned(number, cell, store, paces) for number, cell in enumerate(_cells(experiment, store), 1)]


def chosen(experiment: Experiment, store: RunStore, only: Sequence[str]) -> list[Cell]:
    """Choose rows by their numbers, or by words of their names. InputError: one names no row."""
    cells = _cells(experiment, store)
    names = [row_name(cell) for cell in cells]
    by_place: dict[int, Cell] = {}
    for asked in only:
        numbers = [int(asked) - 1] if asked.isdigit() else [k for k, name in enumerate(names) if asked in name]
        if not numbers or not 0 <= numbers[0] < len(cells):
            rows = "; ".join(f"{k} {name}" for k, name in enumerate(names, 1))
            raise InputError(f"--only {asked}: no such row ({rows})")
        by_place |= {number: cells[number] for number in numbers}
    return [by_place[number] for number in sorted(by_place)]


def paper_rows(experiment: Experiment, rows: Rows) -> Rows:
    """Select the paper's rows that any of these stand beside: they agree in all that both name but the detector."""
    labels = [
        {key: value for key, value in figure.items() if key != "detector" and isinstance(value, str)}
        for figure in experiment.paper
    ]
    agrees = lambda label, row: all(row.get(key, value) in (value, "all") for key, value in label.items())
    beside = [any(agrees(label, row) for row in rows) for label in labels]
    return [dict(figure) for figure, stands in zip(experiment.paper, beside, strict=True) if stands]


def _cells(experiment: Experiment, store: RunStore) -> list[Cell]:
    if experiment.measure:
        raise InputError(f"{experiment.title}: measures in a way of its own, without rows that could be chosen")
    return list(experiment.cells(store))


def _planned(number: int, cell: Cell, store: RunStore, paces: dict[str, DetectorPace]) -> Planned:
    specs = cell.specs or store.specs[:1]
    judges = cell.judges or specs
    updates = batch = 0
    if cell.pattern is None:
        changes = {key: value for key, value in cell.training.items() if key != "bodies"}
        settings = store.train_settings(store.options.seed, specs, **changes)
        updates = len(store.options.seed_list) * settings.total_steps(len(store.split.backgrounds))
        batch = settings.run.batch
    training = updates * batch * _total(paces, specs, "gradient")
    images = _images(cell, store) * (len(store.options.seed_list) if updates else 1)
    return Planned(number, row_name(cell), updates, training + images * _total(paces, judges, "forward"))


def _images(cell: Cell, store: RunStore) -> int:
    """Count the images that judge one training, under every control."""
    changes = {key: value for key, value in cell.test.items() if key != "bodies"}
    settings = store.evaluate_settings(**changes)
    views = store.split.unseen.pose_count * len(cell.angles or test_angles(store)) * settings.images_per_view
    return min(views, settings.most_images or views) * (1 + len(settings.controls))


def _total(paces: dict[str, DetectorPace], specs: Iterable[str], name: str) -> float:
    # Detectors of a store of the cell's own were not timed: they count as the slowest.
    slowest = max(getattr(pace, name) for pace in paces.values())
    return sum(getattr(paces[spec], name) if spec in paces else slowest for spec in specs)
