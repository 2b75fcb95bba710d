"""The figures that experiments have beside `Lines`, `Bars` and `Rings`: matrices, and curves over thresholds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure

from cloak_core.core.evaluation.controls import CLOTHING, LOGO
from cloak_core.core.evaluation.statistics import THRESHOLDS
from cloak_core.studies.report.charts import Lines, Rows, column, detector_names, group, select
from cloak_core.studies.report.plots import heat_map
from cloak_core.studies.report.style import CYCLE, SERIES


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
    """Success against the detection threshold, panels side by side.

    A line for each row of the table, and own clothing of the first; with `by_control` for each control instead.
    """

    where: Mapping[str, object] = field(default_factory=dict)
    panel: str = ""
    by_control: bool = False

    def draw(self, rows: Rows, thresholds: Rows) -> Figure | None:
        """Draw up to seven rows; None for more or none."""
        curves = select(thresholds, **self.where)
        if not self.by_control:
            clothing = select(curves, control=CLOTHING)[:1]
            trained = select(curves, control=LOGO)
            if not 1 <= len(trained) <= len(CYCLE):
                return None
            curves = [row | {"line": label} for row, label in zip(trained, distinct_labels(trained), strict=True)]
            judges = [row.get("tested_on", row.get("detector")) for row in (*clothing, *curves)]
            seen = f", seen by {detector_names(clothing)[judges[0]]}" if len(set(judges)) > 1 else ""
            curves += [row | {"line": SERIES[CLOTHING].label + seen} for row in clothing]
        points = [row | {"threshold": t, "success": row[f"at_{t:g}"]} for row in curves for t in THRESHOLDS]
        series = "control" if self.by_control else "line"
        return Lines(x="threshold", series=series, panel=self.panel, interval="").draw(points)


def distinct_labels(rows: Rows) -> list[str]:
    """Label rows by the columns in which they differ; by the logo's area only where nothing else does."""
    names = detector_names(rows)
    left = {"control", "seconds", "cpu_seconds", "area_share", "logo_faces", "reach"}
    keys = [key for key in rows[0] if key not in left and not key.startswith("at_")]

    def written(key: str, value: object) -> str:
        if isinstance(value, str):
            return f"seen by {names[value]}" if key == "tested_on" else names.get(value, value)
        return f"{100 * value:.1f} %" if key == "area_share" else f"{key.replace('_', ' ')} {value:g}"

    for more in ([], ["area_share"]):
        differing = [key for key in (*keys, *more) if len({str(row.get(key)) for row in rows}) > 1]
        labels = [", ".join(written(key, row[key]) for key in differing) or SERIES[LOGO].label for row in rows]
        if len(set(labels)) == len(labels):
            break
    return labels
