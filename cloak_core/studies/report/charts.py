"""Figures as declarations over rows of a table: what lies along x, what tells series and panels apart.

A row holds plain values: labels, and a share `success` in [0, 1] with its bounds `low` and `high` where there are any.
Whatever shows rates (experiments, reports, cards) makes such rows and draws them here, inside `style.style`.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_bytes
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import write_text
from cloak_core.studies.report.style import (
    INK,
    SERIES,
    WIDTH,
    legend_above,
    look_of,
    new_figure,
    panel_title,
    percent_axis,
)
from cloak_core.studies.report.words import short_names

Rows = list[dict]
"""Rows of a table: plain values by column."""
SPECS = ("detector", "trained_on", "tested_on")
"""Columns that hold detectors' specs."""
AXES = {
    "angle": "azimuth (degrees)",
    "distance": "distance (m)",
    "area_share": "share of the body's area (%)",
    "logo_faces": "faces of the logo",
    "cpu_seconds": "processor time of training (s)",
    "seconds": "training time (s)",
    "steps": "updates of the attack",
    "tv_weight": "weight of total variation",
    "clean_recall": f"clean recall at {THRESHOLD:g} (%)",
    "pattern_alarms": "alarms on cloth (%)",
    "threshold": "detection threshold",
    "within": "mean CIEDE2000 from the print, at most (100: no bound)",
}
"""What columns are called along an axis."""
PERCENT = ("area_share", "clean_recall", "pattern_alarms")
"""Columns shown in per cent along an axis."""
MOST_MARKERS = 30
"""Points of a control's line that are marked."""


def rated(record: Mapping, name: str = "success", bounds: str = "ci95") -> dict:
    """Read a rate and its interval from a record, as columns of a row: success, low, high."""
    low, high = record[bounds]
    return {"success": record[name], "low": low, "high": high}


def select(rows: Rows, **values: object) -> Rows:
    """Select the rows with these values."""
    return [row for row in rows if all(row.get(key) == value for key, value in values.items())]


def group(rows: Rows, key: str) -> dict[Any, Rows]:
    """Group rows by their value in a column, in order; all in one group where `key` is empty."""
    if not key:
        return {"": rows} if rows else {}
    return {value: select(rows, **{key: value}) for value in dict.fromkeys(row[key] for row in rows)}


def column(rows: Rows, key: str = "success") -> list:
    """Select one column."""
    return [row[key] for row in rows]


def detector_names(rows: Rows) -> dict[str, str]:
    """Name the detectors of these rows shortly, by spec."""
    return short_names(str(row[key]) for row in rows for key in SPECS if row.get(key) is not None)


def floats(rows: Rows, key: str = "success") -> Float[np.ndarray, " R"]:
    """Select one column of numbers; nan where there is none."""
    return np.array(column(rows, key), float)


def errors(rows: Rows, value: str = "success", low: str = "low", high: str = "high") -> Float[np.ndarray, "2 R"]:
    """Compute how far the intervals reach below and above each rate."""
    middle = floats(rows, value)
    return np.clip([middle - floats(rows, low), floats(rows, high) - middle], 0, None)


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
    rate: str = "attack success"
    """What success is called."""
    interval: str = "band"
    """How intervals are drawn: band, bars, or "" for none: bands of many curves in one place hide each other."""
    clothing: bool = False
    """Whether own clothing on the same images is drawn, of the first series."""
    beside: Mapping[str, str] = field(default_factory=dict)
    """Further columns drawn in the same place, with their labels."""
    points: Mapping[str, object] = field(default_factory=dict)
    """Further rows of each series, drawn as crosses; the last value names them."""
    even: bool = False
    """Whether values of x stand at even distances."""
    mark: float = THRESHOLD
    """The detection threshold that is marked where thresholds lie along x."""
    size: tuple[float, float] = (WIDTH, 2.9)
    """Width and height, inches."""

    def draw(self, rows: Rows, thresholds: Sequence = ()) -> Figure | None:
        """Draw the rows that have a number in column `x`."""
        names, rows = detector_names(rows), [r for r in rows if isinstance(r.get(self.x), (int, float))]
        crosses = select(rows, **self.points) if self.points else []
        chosen = select(self.keep(rows), **self.where)
        panels, series = group(chosen, self.panel), list(group(chosen, self.series))
        if not panels:
            return None
        figure, axes = new_figure(*self.size, len(panels), sharey=True)
        for axis, (panel, panel_rows) in zip(axes, panels.items(), strict=True):
            values, scale = sorted(set(column(panel_rows + crosses, self.x))), 100 if self.x in PERCENT else 1
            places = {value: k if self.even else scale * value for k, value in enumerate(values)}
            for value, line in group(panel_rows, self.series).items():
                k = series.index(value)
                look = {"label": names.get(value) or self.label.format(value)} | look_of(k, value)
                if value in SERIES and (self.x == "threshold" or len(line) > MOST_MARKERS):
                    look["marker"] = None
                if all(row.get("n") == 1 for row in line):
                    look["ls"] = "none"  # yes or no of single images: a line would make a trend of them
                aside, line = 0.08 * (k - (len(series) - 1) / 2) * self.even, sorted(line, key=lambda row: row[self.x])
                self._line(axis, [float(places[row[self.x]] + aside) for row in line], line, look, first=not k)
                for row in select(crosses, **{self.series: value} if self.series else {})[:1]:
                    look |= {"label": f"{look['label']}, {list(self.points.values())[-1]}", "marker": "x", "ls": ""}
                    axis.plot([places[row[self.x]]], [row[self.y]], **look)
            panel_title(axis, names.get(panel, str(panel)), len(panels))
            self._x_axis(axis, values)
        if self.y == "success":
            percent_axis(axes[0], self.rate)
        else:
            axes[0].set_ylim(bottom=0)
            axes[0].set_ylabel(AXES.get(self.y, self.y.replace("_", " ")))
        legend_above(figure)
        return figure

    def _line(self, axis: Axes, x: Sequence[float], rows: Rows, look: dict, *, first: bool) -> None:
        if self.interval == "bars":
            axis.errorbar(x, floats(rows), errors(rows), lw=1.4, capsize=2, clip_on=False, **look)
        elif self.interval == "band" and "low" in rows[0]:
            axis.plot(x, floats(rows), clip_on=False, zorder=3, **look)
            axis.fill_between(x, floats(rows, "low"), floats(rows, "high"), color=look["color"], alpha=0.15, lw=0)
        else:
            axis.plot(x, floats(rows, self.y), clip_on=False, **look)
        for k, (key, label) in enumerate(self.beside.items()):
            axis.plot(x, column(rows, key), mfc="white", **look_of(k + 1) | {"label": label})
        if self.clothing and first:
            axis.plot(x, column(rows, CLOTHING), lw=1.2, **SERIES[CLOTHING] | {"color": INK, "ls": ":"})

    def _x_axis(self, axis: Axes, values: Sequence[float | int]) -> None:
        axis.set_xlabel(AXES.get(self.x, self.x.replace("_", " ")))
        if self.x == "angle":  # whole degrees, at steps people count in
            low, high = axis.get_xlim()
            steps = (1, 2, 5, 10, 15, 30, 45, 60, 90)
            axis.xaxis.set_major_locator(MultipleLocator(next((s for s in steps if (high - low) / s <= 13), 90)))
            axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "\u2212"))
        if self.x == "threshold":
            axis.axvline(self.mark, color=INK, lw=0.8, ls=":", zorder=0)
        if self.even:
            labels = [f"{value:,}" if isinstance(value, int) else f"{value:g}" for value in values]
            axis.set_xticks(range(len(values)), labels)


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
    rate: str = "attack success"
    """What success is called."""

    def draw(self, rows: Rows, thresholds: Sequence = ()) -> Figure | None:
        """Draw every row of a series."""
        names = detector_names(rows)
        rows = [row for row in rows if not self.labels or row[self.series] in self.labels]
        lines, panels = list(group(rows, self.y)), group(rows, self.panel)
        room = 0.28 if not self.series else max(0.42, 0.1 * len(group(rows, self.series)))
        figure, axes = new_figure(WIDTH, 1.0 + room * len(lines), len(panels), sharey=True)
        for axis, (panel, panel_rows) in zip(axes, panels.items(), strict=True):
            axis.set(xlim=(-0.02, 1.02), xlabel=self.rate)
            axis.set_xticks([0, 0.5, 1], ["0", "50", "100 %"])  # short enough for panels beside each other
            axis.set_xticks([0.25, 0.75], minor=True)
            axis.grid(axis="x", which="minor")
            axis.set_yticks(range(len(lines)), [names.get(line, str(line)) for line in lines])
            axis.set_ylim(len(lines) - 0.5, -0.5)
            axis.grid(axis="y", visible=False)
            series = self._series(rows, panel_rows)
            for k, (label, (shown, keys, value)) in enumerate(series.items()):
                aside = (0.3 if len(series) < 3 else 0.6) * (k - (len(series) - 1) / 2) / max(1, len(series) - 1)
                look = look_of(k, value)
                look = {"fmt": look["marker"], "color": look["color"], "label": look.get("label", label) or None}
                at = [lines.index(row[self.y]) + aside for row in shown]
                axis.errorbar(floats(shown, *keys[:1]), at, xerr=errors(shown, *keys), lw=1.2, clip_on=False, **look)
            for k, control in enumerate(self.controls, 1):
                at = [lines.index(row[self.y]) + 0.15 * k for row in panel_rows]
                axis.plot(column(panel_rows, control), at, **look_of(0, control) | {"ls": ""})
            panel_title(axis, names.get(panel, str(panel)), len(panels))
        legend_above(figure)
        return figure

    def _series(self, rows: Rows, panel_rows: Rows) -> dict[str, tuple[Rows, tuple[str, ...], object]]:
        """List a panel's rows, the columns of their rates, and their value by label; colours agree between panels."""
        if self.own:
            own = panel_rows, ("success_own", "own_low", "own_high"), None
            return {f"threshold {THRESHOLD:g}": (panel_rows, (), None), "own operating point": own}
        labels = self.labels or ({"": SERIES[LOGO]["label"]} if self.controls else {})
        return {
            labels.get(value, str(value)): (
                select(panel_rows, **{self.series: value}) if self.series else panel_rows,
                (),
                value,
            )
            for value in group(rows, self.series)
        }


@dataclass(frozen=True, kw_only=True)
class Rings:
    """Success around the body, seen from above, a ring for each series; own clothing beside them where it is told."""

    series: str
    where: Mapping[str, object] = field(default_factory=dict)

    def draw(self, rows: Rows, thresholds: Sequence = ()) -> Figure | None:
        """Draw the rows that have an angle; the last ring alone has its band: on a circle only one can be read."""
        rings = group([row for row in select(rows, **self.where) if row["angle"] != "all"], self.series)
        figure, (axis,) = new_figure(WIDTH * 0.75, 4.2, subplot_kw={"projection": "polar"})
        for k, (label, panel_rows) in enumerate(rings.items()):
            closed = [*panel_rows, panel_rows[0]]
            at, look = np.unwrap(np.radians(column(closed, "angle"))), look_of(k) | {"marker": None, "label": label}
            axis.plot(at, floats(closed), **look)
        axis.fill_between(at, floats(closed, "low"), floats(closed, "high"), color=look["color"], alpha=0.12, lw=0)
        if CLOTHING in panel_rows[0]:
            axis.plot(at, column(closed, CLOTHING), color=INK, ls=":", lw=1.2, label=SERIES[CLOTHING]["label"])
        axis.set_theta_zero_location("S")  # the front at the bottom, as the camera sees it at azimuth 0
        axis.set_ylim(0, 1)
        axis.set_rlabel_position(135)
        axis.set_yticks([0.25, 0.5, 0.75, 1], ["", "50 %", "", "100 %"])
        axis.set_xticks(np.radians([0, 90, 180, 270]), ["front", "left", "back", "right"])
        figure.legend(*axis.get_legend_handles_labels(), loc="outside upper left")
        return figure


# --- rows that stay with the project: a CSV file a kind of study, and one of how each was made

MAX_BYTES = 64 << 20


def publish_rows(folder: Path, table: str, study: str, rows: Rows, made: Mapping[str, object]) -> Path:
    """Put a study's rows into FOLDER/TABLE.csv in place of its earlier ones; returns the file.

    Detectors stand there by their short names. made: command, versions and counts, a row of FOLDER/studies.csv, where
    paths lose their folders. InputError: a file there is no such table.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = detector_names(rows)
    shown = [
        {key: names.get(str(value), value) if key in SPECS else value for key, value in row.items()} for row in rows
    ]
    provenance = {key: without_folders(value) if key == "command" else value for key, value in made.items()}
    _replace(folder / "studies.csv", f"{table}/{study}", [provenance])
    return _replace(folder / f"{table}.csv", study, shown)


def _replace(path: Path, study: str, rows: Rows) -> Path:
    """Write these rows under a study's name into a table, which keeps those of other studies as they are."""
    table = pd.DataFrame([{"study": study} | row for row in rows], dtype=object)
    if path.exists():
        try:
            known = pd.read_csv(io.BytesIO(read_bytes(path, MAX_BYTES)), dtype=str, keep_default_na=False)
            table = pd.concat([known[known["study"] != study], table])
        except (ValueError, KeyError) as error:
            raise InputError(f"{path}: not a table of studies ({error!r})") from None
    write_text(path, table.to_csv(index=False, lineterminator="\n"))
    return path
