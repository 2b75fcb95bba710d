"""What an experiment declares: the cells of its table, its figures, its caption and the paper's values.

A declaration needs no other import than this one, but for what it trains on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from cloak_core.core.evaluation import CLOTHING
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.statistics import THRESHOLDS
from cloak_core.core.pattern import Pattern
from cloak_core.experiments.logos import FaceIds
from cloak_core.studies.report.charts import Bars, Lines, Rings, Rows, column, detector_names, group, select
from cloak_core.studies.report.plots import heat_map
from cloak_core.studies.report.style import SERIES
from cloak_core.studies.store import RunStore
from cloak_core.studies.training_store import Trained

__all__ = ["MULTI", "SINGLE", "Bars", "Cell", "Cells", "Experiment", "Lines", "Matrix", "Numbers", "Rings", "RunStore"]
__all__ += ["Thresholds", "Trainings", "test_angles"]
SINGLE, MULTI = "0", "-10:10:5"
"""Training azimuths of the paper, degrees."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Cell:
    """One training, repeated by seed, and the evaluation that judges it."""

    label: Mapping[str, object]
    """First columns of its rows."""
    faces: FaceIds | None = None
    """What the logo covers; None: chest + thighs."""
    specs: Sequence[str] = ()
    """Detectors trained against; the first where none are named."""
    training: Mapping[str, object] = field(default_factory=dict)
    """Further arguments of `RunStore.train_faces`: settings, bodies."""
    pattern: Pattern | None = None
    """To be judged without training."""
    begun: Sequence[str] = ()
    """Detectors whose cloak of the same faces, as the experiment's length makes it, the training begins with."""
    judges: Sequence[str] = ()
    """Detectors that judge, a row each; those trained against where none are named."""
    judge_column: str = "detector"
    angles: Sequence[float] = ()
    """Test azimuths, degrees; the paper's where none are given."""
    test: Mapping[str, object] = field(default_factory=dict)
    """Further arguments of `RunStore.measure_repetitions`: settings, bodies."""
    columns: Sequence[str] = ()
    """Of `statistics.operating_row`; none: all of `statistics.training_row`, and curves over thresholds."""
    extra: Callable[[Results, str], dict] = lambda results, spec: {}
    """Further columns of a judge's row over all images."""
    timed: bool = False
    """Whether the rows say how long training took."""
    area: bool = False
    """Whether the rows say what share of the body's area the logo covers."""
    along: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """Columns of the trials and their values, for a further row each; the row over all images has "all" there."""
    baseline: Mapping[str, object] | None = None
    """Label of a further row for own clothing on the same images."""
    store: RunStore | None = None
    """Another store than the experiment's, with more detectors."""


@dataclass(frozen=True, eq=False)
class Numbers:
    """What an experiment measured: plain values."""

    rows: Rows
    facts: dict = field(default_factory=dict)
    thresholds: Rows = field(default_factory=list)
    """Success at every threshold: a row for each control of each row with curves."""
    pictures: dict[str, Image.Image] = field(default_factory=dict)
    """By file name without ending."""


Cells = Iterator[Cell]
Trainings = list[tuple[Cell, list[Trained]]]


@dataclass(frozen=True, kw_only=True)
class Matrix:
    """Success by what was trained on and what judges, as a heat map; controls in rows below."""

    controls: Sequence[str] = ("random", CLOTHING)

    def draw(self, rows: Rows, thresholds: Sequence = ()) -> Figure | None:
        """Draw where several detectors were trained on."""
        names = detector_names(rows)
        by_source = group(rows, "trained_on")
        if len(by_source) < 2:
            return None
        tested = next(iter(by_source.values()))  # controls wear nothing trained: alike under every source
        shares = [column(of_source) for of_source in by_source.values()] + [column(tested, c) for c in self.controls]
        heads = [names[spec] for spec in by_source]
        below = [SERIES[control]["label"] for control in self.controls]
        figure = heat_map(np.array(shares), [*heads, *below], heads, rule=len(heads))
        figure.axes[0].set(xlabel="tested on", ylabel="trained on")
        return figure


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Success against the detection threshold, panels side by side: a line for each control."""

    where: Mapping[str, object] = field(default_factory=dict)
    panel: str = ""

    def draw(self, rows: Rows, thresholds: Rows) -> Figure | None:
        """Draw the curves of the rows of the table that are asked for."""
        curves = select(thresholds, **self.where)
        points = [row | {"threshold": t, "success": row[f"at_{t:g}"]} for row in curves for t in THRESHOLDS]
        return Lines(x="threshold", series="control", panel=self.panel, interval="").draw(points)


@dataclass(frozen=True, eq=False, kw_only=True)
class Experiment:
    """One experiment: what is trained, what judges, what is plotted, what the paper has."""

    title: str
    caption: str
    """What was done and how to read it."""
    cells: Callable[[RunStore], Cells] = lambda store: iter(())
    figures: Mapping[str, Bars | Lines | Rings | Matrix | Thresholds]
    """By file name without ending."""
    paper: Sequence[Mapping[str, object]] = ()
    pictures: Callable[[RunStore, Trainings], dict[str, Image.Image]] = lambda store, trainings: {}
    facts: Mapping[str, object] = field(default_factory=dict)
    counts: Callable[[RunStore], dict] = lambda store: {}
    """What it does otherwise than the options' counts say."""
    measure: Callable[[RunStore], Numbers] | None = None
    """Instead of `cells`, for what these cannot say."""
    finish: Callable[[Rows], Rows] = lambda rows: rows
    """Add columns that compare rows."""


def test_angles(store: RunStore) -> tuple[float, ...]:
    """List the paper's test azimuths: whole degrees in -10..10; every second one when quick."""
    return tuple(float(a) for a in range(-10, 11, 2 if store.options.quick else 1))
