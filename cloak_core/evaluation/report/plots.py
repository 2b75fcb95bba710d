"""Draw rates: lines with bands, bars, rings and heat maps; and the plots of an evaluation.

The parts take an axis and rates; the plots of an evaluation take its results and return a figure. Call them inside
`style.style`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.intervals import Rate
from cloak_core.evaluation.report.style import (
    CYCLE,
    DASHES,
    INK,
    MARKERS,
    SERIES,
    WIDTH,
    azimuth_axis,
    legend_above,
    new_figure,
    percent_along_x,
    percent_axis,
)
from cloak_core.evaluation.results import Results
from cloak_core.evaluation.statistics import by_value, hidden_rate, share

Curves = dict[str, list[tuple[float, float]]]
"""Named curves of (step, value)."""
Along = Sequence | np.ndarray
"""Numbers along an axis, whatever their type."""
MOST_BODIES = 40
"""Bodies that a plot names one by one."""


# --- parts of a plot


def numbered_series(k: int) -> dict:
    """Look up colour, marker and dash of the k-th series."""
    return {"color": CYCLE[k % 7], "marker": MARKERS[k % 7], "ls": DASHES[k % 7]}


def named_series(control: str) -> dict:
    """Look up colour, marker, dash and label of the logo or a control."""
    series = SERIES[control]
    return {"color": series.color, "marker": series.marker, "ls": series.dash, "label": series.label}


def read_rates(rows: Sequence[Mapping], key: str = "success", bounds: str | None = None) -> list[Rate]:
    """Read rates from rows of plain values: bounds under `low` and `high`, or as a pair under the key `bounds`."""
    ends = [(row["low"], row["high"]) if bounds is None else row[bounds] for row in rows]
    return [Rate(row[key], *end, row.get("n", 0)) for row, end in zip(rows, ends, strict=True)]


def values(rates: Sequence[Rate]) -> Float[np.ndarray, " R"]:
    """Return the rates themselves; nan where there is none."""
    return np.array([rate.value for rate in rates], float)


def errors(rates: Sequence[Rate]) -> Float[np.ndarray, "2 R"]:
    """Compute how far the intervals reach below and above each rate."""
    low, value, high = (np.array([getattr(r, key) for r in rates], float) for key in ("low", "value", "high"))
    return np.clip([value - low, high - value], 0, None)


def band(axis: Axes, x: Along, rates: Sequence[Rate], label: str, alpha: float = 0.15, **look: object) -> None:
    """Draw a line of rates with its band of intervals."""
    axis.plot(x, values(rates), label=label, clip_on=False, zorder=3, **look)
    low, high = (np.array([getattr(rate, key) for rate in rates], float) for key in ("low", "high"))
    axis.fill_between(x, low, high, color=look["color"], alpha=alpha, lw=0)


def clothing_line(axis: Axes, x: Along, shares: Along, color: str = INK) -> None:
    """Draw what own clothing does on the same images."""
    own = SERIES[CLOTHING]
    axis.plot(x, shares, color=color, lw=1.2, ls=":", marker=own.marker, label=own.label)


def rate_bars(axis: Axes, rates: Sequence[Rate], at: Along, color: str, marker: str = "o", label: str = "") -> None:
    """Draw rates along x with their intervals, one below the other at the heights `at`."""
    look = {"fmt": marker, "color": color, "label": label or None}
    axis.errorbar(values(rates), at, xerr=errors(rates), lw=1.2, clip_on=False, **look)


def rates_along_x(axis: Axes, names: Sequence[str], label: str = "attack success") -> None:
    """Set up rates along x, and a name for each line down y."""
    percent_along_x(axis)
    axis.set_xlabel(label)
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.grid(axis="y", visible=False)


def ring(axis: Axes, angles: Along, shares: Along, rates: Sequence[Rate] = (), **look: object) -> None:
    """Draw a closed line of shares around the body; with the band of their intervals where `rates` are given."""
    at = np.unwrap(np.radians([*angles, angles[0]]))
    axis.plot(at, [*shares, shares[0]], **look)
    if rates:
        low, high = ([getattr(rate, key) for rate in (*rates, rates[0])] for key in ("low", "high"))
        axis.fill_between(at, low, high, color=look["color"], alpha=0.12, lw=0)


def compass(axis: Axes) -> None:
    """Set up a polar axis seen from above: front at the bottom, as the camera sees it at azimuth 0."""
    axis.set_theta_zero_location("S")
    axis.set_ylim(0, 1)
    axis.set_rlabel_position(135)
    axis.set_yticks([0.25, 0.5, 0.75, 1], ["", "50 %", "", "100 %"])
    axis.set_xticks(np.radians([0, 90, 180, 270]), ["front", "left", "back", "right"])


def threshold_axis(axis: Axes) -> None:
    """Set up detection thresholds along x, and mark the usual one."""
    axis.axvline(THRESHOLD, color=INK, lw=0.8, ls=":", zorder=0)
    axis.set_xlabel("detection threshold")


def heat_map(
    shares: Float[np.ndarray, "R C"], rows: Sequence[str], columns: Sequence[str], *, rule: int | None = None
) -> Figure:
    """Draw shares as a heat map with its numbers in per cent, "–" where nan; `rule`: a line above this row."""
    figure, (axis,) = new_figure(2.4 + 0.62 * shares.shape[1], 1.5 + 0.3 * len(shares))
    axis.imshow(shares, cmap="cividis", vmin=0, vmax=1, aspect="auto")
    axis.grid(visible=False)
    for (i, j), value in np.ndenumerate(shares):
        words = "–" if np.isnan(value) else f"{100 * value:.0f}"
        axis.text(j, i, words, ha="center", va="center", color="black" if value > 0.55 else "white", fontsize=8)
    if rule is not None:
        axis.axhline(rule - 0.5, color="white", lw=3)
    axis.set_xticks(range(shares.shape[1]), columns, rotation=40, ha="right", rotation_mode="anchor")
    axis.set_yticks(range(len(shares)), rows)
    axis.set_title("success in %")
    return figure


# --- the plots of an evaluation


def success_by_angle(results: Results, detector: str, threshold: float) -> Figure:
    """Plot success of the trained colours with its 95 % band, and of every control, over the azimuth."""
    figure = _success_by(results, detector, "angle", threshold, width=2 * WIDTH, height=3.0)
    azimuth_axis(figure.axes[0])
    return figure


def success_by_distance(results: Results, detector: str, threshold: float) -> Figure:
    """Plot success over the camera's distance."""
    figure = _success_by(results, detector, "distance", threshold)
    figure.axes[0].set_xlabel("distance (m)")
    return figure


def _success_by(results: Results, detector: str, column: str, threshold: float, **size: float) -> Figure:
    figure, (axis,) = new_figure(**size)
    for control in results.controls:
        groups = list(by_value(results.rows(detector, control), column))
        x, look = [key for key, _ in groups], named_series(control) | {"markersize": 4.5 if len(groups) <= 30 else 0}
        if max(len(rows) for _, rows in groups) == 1:
            look |= {"ls": "none", "markersize": 4.5}  # yes or no of single images: a line would make a trend of them
        if control == results.controls[0]:
            band(axis, x, [hidden_rate(rows, threshold) for _, rows in groups], alpha=0.18, **look)
        else:
            axis.plot(x, [share(rows, threshold) for _, rows in groups], clip_on=False, zorder=2, **look)
    percent_axis(axis)
    legend_above(figure)
    return figure


def success_by_body(results: Results, detector: str, threshold: float) -> Figure:
    """Plot success of trained colours and controls on each body with intervals; of many bodies sorted, without."""
    poses = [int(pose) for pose, _ in by_value(results.rows(detector, results.controls[0]), "pose")]
    if len(poses) > MOST_BODIES:
        return _success_sorted(results, detector, threshold)
    count = len(results.controls)
    figure, (axis,) = new_figure(height=max(2.9, 1.0 + (0.2 + 0.1 * count) * len(poses)))
    for c, control in enumerate(results.controls):
        rates = [hidden_rate(rows, threshold) for _, rows in by_value(results.rows(detector, control), "pose")]
        at, look = np.arange(len(poses)) + (c - (count - 1) / 2) * 0.7 / count, SERIES[control]
        rate_bars(axis, rates, at, look.color, look.marker, look.label)
    rates_along_x(axis, [results.body_names[pose] for pose in poses])
    axis.set_ylim(len(poses) - 0.45, -0.55)
    legend_above(figure)
    return figure


def _success_sorted(results: Results, detector: str, threshold: float) -> Figure:
    """Plot success on every body, each pattern's bodies from its worst to its best."""
    figure, (axis,) = new_figure()
    for control in results.controls:
        shares = np.sort([share(rows, threshold) for _, rows in by_value(results.rows(detector, control), "pose")])
        look = named_series(control) | {"marker": None}
        axis.step(np.arange(len(shares)) + 1, shares, where="mid", **look)
    percent_axis(axis)
    axis.set_xlabel("bodies, from the worst to the best")
    legend_above(figure)
    return figure


def success_by_threshold(results: Results, detector: str, threshold: float) -> Figure:
    """Plot the share of images without a person box above t for every t; `threshold` is marked."""
    figure, (axis,) = new_figure()
    grid = np.linspace(0, 1, 201)
    for control in results.controls:
        score = np.sort(results.scores(detector, control))
        shares = np.searchsorted(score, grid, side="right") / len(score)
        axis.plot(grid, shares, **named_series(control) | {"marker": None})
    axis.axvline(threshold, color=INK, lw=0.8, ls=(0, (2, 2)))
    place = {"xytext": (4, 0), "textcoords": "offset points", "rotation": 90, "va": "center"}
    axis.annotate(f"threshold {threshold:g}", (threshold, 0.5), fontsize=8, **place)
    percent_axis(axis)
    axis.set_xlim(0, 1)
    axis.set_xlabel("detection threshold")
    legend_above(figure)
    return figure


def success_over_time(rows: Sequence[Mapping], labels: Mapping[str, str]) -> Figure:
    """Plot the rows of `over_time` over queries, where it was a search, else seconds, else steps.

    labels: the name of each detector, by spec.
    """
    axis_of = {"queries": "queries", "seconds": "training time (s)", "step": "step"}
    along = next(key for key in axis_of if all(row.get(key) is not None for row in rows))
    figure, (axis,) = new_figure()
    for k, (spec, label) in enumerate(labels.items()):
        rates = read_rates([row["detectors"][spec] for row in rows], bounds="ci95")
        band(axis, [row[along] for row in rows], rates, label, alpha=0.12, **numbered_series(k))
    axis.set_xlabel(axis_of[along])
    percent_axis(axis)
    legend_above(figure)
    return figure


def found_by_distance(groups: Mapping[str, Mapping], labels: Mapping[str, str]) -> Figure:
    """Plot the share of people found over the distance (keys, metres), with and without the cloak.

    groups: by distance and by side ("with", "without"), a record with `detected`; labels: the sides' names.
    """
    figure, (axis,) = new_figure()
    for side, control in (("with", LOGO), ("without", CLOTHING)):
        rows = {float(key): told[side] for key, told in groups.items() if told[side]["detected"] is not None}
        rates = read_rates(list(rows.values()), "detected", "ci95_detected")
        band(axis, list(rows), rates, alpha=0.18, **named_series(control) | {"label": labels[side]})
    percent_axis(axis, "found")
    axis.set_xlabel("distance (m)")
    legend_above(figure)
    return figure


def training_curves(losses: Curves, success: list[tuple[float, float]]) -> Figure:
    """Plot losses over the steps, and the success that training saw on its own images."""
    figure, axes = new_figure(width=2 * WIDTH, columns=2 if losses and success else 1, height=2.8)
    if losses:
        axis = axes[0]
        for k, (name, points) in enumerate(losses.items()):
            _curve(axis, points, CYCLE[k % len(CYCLE)], name)
        axis.set_ylim(bottom=0)
        axis.set_title("Loss")
        axis.set_xlabel("step")
        if len(losses) > 1:
            axis.legend()
    if success:
        axis = axes[-1]
        _curve(axis, success, CYCLE[0], "success")
        percent_axis(axis, "")
        axis.set_title("Success on training images")
        axis.set_xlabel("step")
    return figure


def _curve(axis: Axes, points: list[tuple[float, float]], color: str, label: str) -> None:
    """Draw the points faintly, and their running mean over a fiftieth of them."""
    step, value = np.array(points, float).T
    window = max(1, len(value) // 50)
    if window > 1:
        axis.plot(step, value, color=color, lw=0.6, alpha=0.35)
        kernel = np.ones(window)
        value = np.convolve(value, kernel, "same") / np.convolve(np.ones(len(value)), kernel, "same")
    axis.plot(step, value, color=color, label=label)
