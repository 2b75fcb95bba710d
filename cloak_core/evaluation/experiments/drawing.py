"""What the experiments' figures have in common: rows as lines and bars with their intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.experiments.numbers import Rows, column, group, select
from cloak_core.evaluation.figures import (
    CYCLE,
    DASHES,
    INK,
    MARKERS,
    SERIES,
    azimuth_axis,
    legend_above,
    new_figure,
    percent_along_x,
    percent_axis,
)
from cloak_core.evaluation.rates import THRESHOLDS
from cloak_core.evaluation.report.words import short_name


def look(k: int) -> dict:
    """Colour, marker and dash of the k-th series."""
    return {"color": CYCLE[k % 7], "marker": MARKERS[k % 7], "ls": DASHES[k % 7]}


def errors(rows: Rows) -> Float[np.ndarray, "2 R"]:
    """How far the intervals reach below and above each row's success."""
    low, value, high = (np.array(column(rows, key), float) for key in ("low", "success", "high"))
    return np.clip([value - low, high - value], 0, None)


def band(axis: Axes, x: Sequence[float], rows: Rows, label: str, alpha: float = 0.15, **look: object) -> None:
    """A line of rates with its band of intervals."""
    axis.plot(x, column(rows), label=label, clip_on=False, zorder=3, **look)
    axis.fill_between(x, column(rows, "low"), column(rows, "high"), color=look["color"], alpha=alpha, lw=0)


def clothing_line(axis: Axes, x: Sequence[float], rows: Rows, color: str = INK) -> None:
    """What own clothing does on the same images."""
    own = SERIES[CLOTHING]
    axis.plot(x, column(rows, CLOTHING), color=color, lw=1.2, ls=":", marker=own.marker, label=own.label)


def rate_bars(axis: Axes, rows: Rows, at: Sequence, color: str, marker: str = "o", label: str = "") -> None:
    """Rates along x with their intervals, one below the other at the heights `at`."""
    axis.errorbar(
        column(rows), at, xerr=errors(rows), fmt=marker, color=color, lw=1.2, label=label or None, clip_on=False
    )


def rates_along_x(axis: Axes, names: Sequence[str]) -> None:
    """Success along x, and a name for each line down y."""
    percent_along_x(axis)
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.grid(axis="y", visible=False)


def angle_panels(rows: Rows, panel: str, curve: str, label: str) -> Figure:
    """Success over the azimuth: a panel for each value in one column, a curve for each in another.

    Without bands: those of several curves in one place hide each other. The intervals are in the table.
    """
    panels = group(rows, panel)
    figure, axes = new_figure(columns=len(panels), sharey=True)
    for axis, (name, shown) in zip(axes, panels.items(), strict=True):
        for k, (value, mine) in enumerate(group(shown, curve).items()):
            axis.plot(column(mine, "angle"), column(mine), label=label.format(value), clip_on=False, **look(k))
        axis.set_title(name)
        azimuth_axis(axis)
    percent_axis(axes[0])
    legend_above(figure)
    return figure


def ring(axis: Axes, rows: Rows, key: str, color: str, dash: object, name: str, banded: bool = False) -> None:
    """A closed line of one column around the body, with its band of intervals where asked for."""
    rows = [*rows, rows[0]]
    at = np.unwrap(np.radians(column(rows, "angle")))
    axis.plot(at, column(rows, key), color=color, ls=dash, lw=1.8 if key == "success" else 1.2, label=name)
    if banded:
        axis.fill_between(at, column(rows, "low"), column(rows, "high"), color=color, alpha=0.12, lw=0)


def compass(axis: Axes) -> None:
    """A polar axis seen from above: front at the bottom, as the camera sees it at azimuth 0."""
    axis.set_theta_zero_location("S")
    axis.set_ylim(0, 1)
    axis.set_rlabel_position(135)
    axis.set_yticks([0.25, 0.5, 0.75, 1], ["", "50 %", "", "100 %"])
    axis.set_xticks(np.radians([0, 90, 180, 270]), ["front", "left", "back", "right"])


def threshold_axis(axis: Axes) -> None:
    """Detection thresholds along x, the usual one marked."""
    axis.axvline(THRESHOLD, color=INK, lw=0.8, ls=":", zorder=0)
    axis.set_xlabel("detection threshold")


def threshold_curve(row: dict) -> list[float]:
    """Success at every one of `THRESHOLDS`."""
    return [row[f"at_{t:g}"] for t in THRESHOLDS]


def threshold_figure(rows: Rows) -> Figure | None:
    """Success of the trained colours against the threshold, a line for each row of the table; None for too many.

    Own clothing is drawn for the first: what the choice of a threshold does to the clean detector.
    """
    mine = select(rows, control=LOGO)
    if not 1 <= len(mine) <= len(CYCLE):
        return None
    figure, (axis,) = new_figure()
    for k, (label, row) in enumerate(zip(_labels(mine), mine, strict=True)):
        axis.plot(THRESHOLDS, threshold_curve(row), label=label, clip_on=False, **look(k))
    own = select(rows, control=CLOTHING)[0]
    judges = [str(row.get("tested_on", row.get("detector", ""))) for row in (own, *mine)]
    label = SERIES[CLOTHING].label + (f", seen by {short_name(judges[0])}" if len(set(judges)) > 1 else "")
    axis.plot(THRESHOLDS, threshold_curve(own), color=INK, lw=1.2, ls=(0, (1, 2)), label=label, clip_on=False)
    percent_axis(axis)
    threshold_axis(axis)
    legend_above(figure)
    return figure


def _labels(rows: Rows) -> list[str]:
    """What tells the rows apart, in words; the logo's area only where nothing else does."""
    known = ("control", "seconds", "cpu_seconds", "area_share", "logo_faces", "reach")
    keys = [k for k in rows[0] if k not in known and not k.startswith("at_")]
    for more in ([], ["area_share"]):
        told = [k for k in (*keys, *more) if len({str(row.get(k)) for row in rows}) > 1]
        labels = [", ".join(_named(key, row[key]) for key in told) or SERIES[LOGO].label for row in rows]
        if len(set(labels)) == len(labels):
            break
    return labels


def _named(key: str, value: object) -> str:
    if key == "area_share":
        return f"{100 * value:.1f} %"
    if key == "tested_on":
        return f"seen by {short_name(value)}"
    if isinstance(value, str):
        return short_name(value) if key in ("detector", "trained_on") else value
    return f"{key.replace('_', ' ')} {value:g}"
