"""Figures as declarations over rows of a table: what lies along x, what tells series and panels apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.report import plots
from cloak_core.evaluation.report.style import (
    CYCLE,
    INK,
    SERIES,
    WIDTH,
    azimuth_axis,
    legend_above,
    new_figure,
    panel_title,
    percent_axis,
)
from cloak_core.evaluation.statistics import THRESHOLDS
from cloak_core.experiments.tables import Rows, column, detector_names, group, select

AXES = {
    "angle": "azimuth (degrees)",
    "distance": "distance (m)",
    "area_share": "share of the body's area (%)",
    "logo_faces": "faces of the logo",
    "cpu_seconds": "processor time of training (s)",
    "steps": "updates of the attack",
    "tv_weight": "weight of total variation",
    "clean_recall": f"clean recall at {THRESHOLD:g} (%)",
    "false_alarms": f"false alarms at {THRESHOLD:g} (%)",
    "threshold": "detection threshold",
    "within": "mean CIEDE2000 from the print, at most (100: no bound)",
}
"""What columns are called along an axis."""
PERCENT = ("area_share", "clean_recall", "false_alarms")
"""Columns shown in per cent along an axis."""


@runtime_checkable
class Chart(Protocol):
    """A figure of a table."""

    def draw(self, rows: Rows, thresholds: Rows) -> Figure | None:
        """Draw the table's rows, or their curves over thresholds; None where they have nothing to show."""


@dataclass(frozen=True, kw_only=True)
class Lines:
    """Success over a numeric column: a line for each series, panels side by side."""

    x: str
    y: str = "success"
    series: str = ""
    panel: str = ""
    where: Mapping[str, object] = field(default_factory=dict)
    """Which rows are shown, by column."""
    keep: Callable[[Rows], Rows] = lambda rows: rows
    """Which rows are shown, by comparing them."""
    label: str = "{}"
    """Of a series, from its value."""
    interval: str = "band"
    """How intervals are drawn: band, bars, or "" for none: bands of many curves in one place hide each other."""
    clothing: bool = False
    """Whether own clothing on the same images is drawn, of the first series."""
    beside: Mapping[str, str] = field(default_factory=dict)
    """Further columns drawn in the same place, with their labels."""
    points: Mapping[str, object] = field(default_factory=dict)
    """Further rows of each series, drawn as crosses; the last value names them."""
    log: bool = False
    even: bool = False
    """Whether values of x stand at even distances."""

    def draw(self, rows: Rows, thresholds: Sequence = ()) -> Figure | None:
        """Draw the rows that have a number in column `x`."""
        names, rows = detector_names(rows), [r for r in rows if isinstance(r.get(self.x), (int, float))]
        crosses = select(rows, **self.points) if self.points else []
        chosen = select(self.keep(rows), **self.where)
        panels, series = group(chosen, self.panel), list(group(chosen, self.series))
        if not panels:
            return None
        figure, axes = new_figure(columns=len(panels), sharey=True)
        for axis, (panel, mine) in zip(axes, panels.items(), strict=True):
            places = self._places(mine + crosses)
            for value, line in group(mine, self.series).items():
                k = series.index(value)
                look, aside = self._look(k, value, names), 0.08 * (k - (len(series) - 1) / 2) if self.even else 0.0
                line = sorted(line, key=lambda row: row[self.x])
                self._line(axis, [float(places[row[self.x]] + aside) for row in line], line, look, first=not k)
                self._cross(axis, places, select(crosses, **{self.series: value} if self.series else {})[:1], look)
            panel_title(axis, names.get(panel, str(panel)), len(panels))
            self._x_axis(axis, places)
        self._y_axis(axes[0])
        legend_above(figure)
        return figure

    def _cross(self, axis: Axes, places: Mapping, rows: Rows, look: Mapping) -> None:
        for row in rows:
            label = f"{look['label']}, {list(self.points.values())[-1]}"
            axis.plot([places[row[self.x]]], [row[self.y]], ls="", marker="x", color=look["color"], label=label)

    def _places(self, rows: Rows) -> dict:
        """Find the places of the values of x along the axis."""
        values = sorted(set(column(rows, self.x)))
        if self.even:
            return {value: k for k, value in enumerate(values)}
        return {value: 100 * value if self.x in PERCENT else value for value in values}

    def _look(self, k: int, value: object, names: Mapping[str, str]) -> dict:
        if self.series == "control" and value in SERIES:
            return plots.named_series(value) | {"marker": None}
        return plots.numbered_series(k) | {"label": names.get(value) or self.label.format(value)}

    def _line(self, axis: Axes, x: Sequence[float], rows: Rows, look: dict, *, first: bool) -> None:
        if self.interval == "band":
            plots.band(axis, x, plots.read_rates(rows), **look)
        elif self.interval == "bars":
            rates = plots.read_rates(rows)
            axis.errorbar(x, plots.values(rates), plots.errors(rates), lw=1.4, capsize=2, clip_on=False, **look)
        else:
            axis.plot(x, np.array(column(rows, self.y), float), clip_on=False, **look)
        for k, (key, label) in enumerate(self.beside.items()):
            axis.plot(x, column(rows, key), mfc="white", **plots.numbered_series(k + 1) | {"label": label})
        if self.clothing and first:
            plots.clothing_line(axis, x, column(rows, CLOTHING))

    def _x_axis(self, axis: Axes, places: Mapping) -> None:
        if self.x == "angle":
            azimuth_axis(axis)
        if self.x == "threshold":
            plots.threshold_axis(axis)
        axis.set_xlabel(AXES.get(self.x, self.x.replace("_", " ")))
        if self.log:
            axis.set_xscale("log")
            axis.xaxis.set_major_formatter(LogFormatter())
            axis.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
        if self.even:
            axis.set_xticks(
                range(len(places)), [f"{value:,}" if isinstance(value, int) else f"{value:g}" for value in places]
            )

    def _y_axis(self, axis: Axes) -> None:
        if self.y == "success":
            percent_axis(axis)
        else:
            axis.set_ylim(bottom=0)
            axis.set_ylabel(AXES.get(self.y, self.y.replace("_", " ")))


@dataclass(frozen=True, kw_only=True)
class Bars:
    """Success along x with intervals: a line down for each value of a column, panels side by side."""

    y: str
    series: str = ""
    panel: str = ""
    labels: Mapping[object, str] = field(default_factory=dict)
    """What series are called; rows of others are left out."""
    controls: Sequence[str] = ()
    """Drawn as marks on the same lines."""
    own: bool = False
    """Whether success at 0.6 and at the detectors' own thresholds are the two series."""

    def draw(self, rows: Rows, thresholds: Sequence = ()) -> Figure | None:
        """Draw every row of a series."""
        names = detector_names(rows)
        rows = [row for row in rows if not self.labels or row[self.series] in self.labels]
        lines, panels = list(group(rows, self.y)), group(rows, self.panel)
        figure, axes = new_figure(
            WIDTH, 1.0 + (0.28 if not self.series else 0.42) * len(lines), len(panels), sharey=True
        )
        for axis, (panel, mine) in zip(axes, panels.items(), strict=True):
            plots.rates_along_x(axis, [names.get(line, line) for line in lines])
            series = self._series(rows, mine)
            for k, (label, (shown, key)) in enumerate(series.items()):
                look, offset = plots.numbered_series(k), 0.3 * (k - (len(series) - 1) / 2) / max(1, len(series) - 1)
                at = [lines.index(row[self.y]) + offset for row in shown]
                rates = plots.read_rates(shown, *key)
                plots.rate_bars(axis, rates, at, look["color"], look["marker"], label)
            for k, control in enumerate(self.controls, 1):
                at = [lines.index(row[self.y]) + 0.15 * k for row in mine]
                axis.plot(column(mine, control), at, **plots.named_series(control) | {"ls": ""})
            panel_title(axis, names.get(panel, str(panel)), len(panels))
        legend_above(figure)
        return figure

    def _series(self, rows: Rows, mine: Rows) -> dict[str, tuple[Rows, tuple[str, ...]]]:
        """List a panel's rows and the columns of their rates by label; colours agree between panels."""
        if self.own:
            ends = [row | {"own": (row["own_low"], row["own_high"])} for row in mine]
            return {f"threshold {THRESHOLD:g}": (mine, ()), "own operating point": (ends, ("success_own", "own"))}
        found = {
            value: select(mine, **{self.series: value}) if self.series else mine for value in group(rows, self.series)
        }
        labels = self.labels or ({"": SERIES[LOGO].label} if self.controls else {})
        return {labels.get(value, str(value)): (shown, ()) for value, shown in found.items()}


@dataclass(frozen=True, kw_only=True)
class Rings:
    """Success around the body on a polar axis, a ring for each series; own clothing beside them."""

    series: str
    where: Mapping[str, object] = field(default_factory=dict)

    def draw(self, rows: Rows, thresholds: Sequence = ()) -> Figure | None:
        """Draw the rows that have an angle; the last ring alone has its band: on a circle only one can be read."""
        rings = group([row for row in select(rows, **self.where) if row["angle"] != "all"], self.series)
        figure, (axis,) = new_figure(WIDTH * 0.75, 4.2, subplot_kw={"projection": "polar"})
        for k, (label, mine) in enumerate(rings.items()):
            look, angles = plots.numbered_series(k) | {"marker": None, "label": label}, column(mine, "angle")
            rates = plots.read_rates(mine) if k == len(rings) - 1 else ()
            plots.ring(axis, angles, column(mine), rates, **look)
        plots.ring(axis, angles, column(mine, CLOTHING), color=INK, ls=":", lw=1.2, label=SERIES[CLOTHING].label)
        plots.compass(axis)
        figure.legend(*axis.get_legend_handles_labels(), loc="outside upper left")
        return figure


@dataclass(frozen=True, kw_only=True)
class Matrix:
    """Success by what was trained on and what judges, as a heat map; controls in rows below."""

    controls: Sequence[str] = ("random", CLOTHING)

    def draw(self, rows: Rows, thresholds: Sequence = ()) -> Figure | None:
        """Draw where several detectors were trained on."""
        names, by_source = detector_names(rows), group(rows, "trained_on")
        if len(by_source) < 2:
            return None
        tested = next(iter(by_source.values()))  # controls wear nothing trained: alike under every source
        shares = [column(mine) for mine in by_source.values()] + [column(tested, c) for c in self.controls]
        heads = [names[spec] for spec in by_source]
        below = [SERIES[control].label for control in self.controls]
        figure = plots.heat_map(np.array(shares), [*heads, *below], heads, rule=len(heads))
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
        mine = select(thresholds, **self.where)
        if not self.by_control:
            own, mine = select(mine, control=CLOTHING)[:1], select(mine, control=LOGO)
            if not 1 <= len(mine) <= len(CYCLE):
                return None
            mine = [row | {"line": label} for row, label in zip(mine, distinct_labels(mine), strict=True)]
            judges = [row.get("tested_on", row.get("detector")) for row in (*own, *mine)]
            seen = f", seen by {detector_names(own)[judges[0]]}" if len(set(judges)) > 1 else ""
            mine += [row | {"line": SERIES[CLOTHING].label + seen} for row in own]
        points = [row | {"threshold": t, "success": row[f"at_{t:g}"]} for row in mine for t in THRESHOLDS]
        series = "control" if self.by_control else "line"
        return Lines(x="threshold", series=series, panel=self.panel, interval="").draw(points)


def distinct_labels(rows: Rows) -> list[str]:
    """Label rows by the columns in which they differ; by the logo's area only where nothing else does."""
    names = detector_names(rows)
    left = {"control", "seconds", "cpu_seconds", "area_share", "logo_faces", "reach"}
    keys = [key for key in rows[0] if key not in left and not key.startswith("at_")]
    for more in ([], ["area_share"]):
        told = [key for key in (*keys, *more) if len({str(row.get(key)) for row in rows}) > 1]
        labels = [", ".join(_value(key, row[key], names) for key in told) or SERIES[LOGO].label for row in rows]
        if len(set(labels)) == len(labels):
            break
    return labels


def _value(key: str, value: object, names: Mapping[str, str]) -> str:
    if isinstance(value, str):
        return f"seen by {names[value]}" if key == "tested_on" else names.get(value, value)
    return f"{100 * value:.1f} %" if key == "area_share" else f"{key.replace('_', ' ')} {value:g}"
