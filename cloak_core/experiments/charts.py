"""The figures that experiments have beside `Lines`, `Bars` and `Rings`: matrices, and curves over thresholds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure

from cloak_core.core.evaluation.controls import CLOTHING
from cloak_core.core.evaluation.statistics import THRESHOLDS
from cloak_core.studies.report.charts import Lines, Rows, column, detector_names, group, select
from cloak_core.studies.report.plots import heat_map
from cloak_core.studies.report.style import SERIES


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
        below = [SERIES[control].label for control in self.controls]
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
