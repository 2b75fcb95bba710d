"""The report's plots, as figures; `page` puts them into the page. Each takes data and returns a matplotlib figure."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cloak_core.evaluation.figures import (
    CYCLE,
    SERIES,
    WIDTH,
    azimuth_axis,
    legend_above,
    new_figure,
    percent_along_x,
    percent_axis,
)
from cloak_core.evaluation.intervals import Rate
from cloak_core.evaluation.measurement import Measurement
from cloak_core.evaluation.rates import group_rates

Curves = dict[str, list[tuple[float, float]]]
"""Named curves of (step, value)."""


MOST_BODIES = 40
"""Bodies that a plot names one by one."""


def success_by_angle(measurement: Measurement, detector: int, threshold: float) -> Figure:
    """Success of the trained colours with its 95 % band, and of every control, over the azimuth."""
    figure = _grouped(measurement, detector, "angle", threshold, width=2 * WIDTH, height=3.0)
    azimuth_axis(figure.axes[0])
    return figure


def success_by_distance(measurement: Measurement, detector: int, threshold: float) -> Figure:
    """Success over the camera's distance."""
    figure = _grouped(measurement, detector, "distance", threshold)
    figure.axes[0].set_xlabel("distance (m)")
    return figure


def _grouped(measurement: Measurement, detector: int, column: str, threshold: float, **size: float) -> Figure:
    figure, (axis,) = new_figure(**size)
    for c, control in enumerate(measurement.controls):
        keys, rates = group_rates(measurement, detector, c, getattr(measurement.trials, column), threshold)
        line(axis, keys, rates, control, band=c == 0)
    percent_axis(axis)
    legend_above(figure)
    return figure


def line(axis: object, keys: np.ndarray, rates: list[Rate], name: str, band: bool = True) -> None:
    """One series of rates with its band of intervals."""
    look = SERIES[name]
    drawn = {"color": look.color, "marker": look.marker, "ls": look.dash, "markersize": 4.5 if len(keys) <= 30 else 0}
    axis.plot(keys, [r.value for r in rates], label=look.label, clip_on=False, zorder=3 if band else 2, **drawn)
    if band:
        axis.fill_between(keys, [r.low for r in rates], [r.high for r in rates], color=look.color, alpha=0.18, lw=0)


def success_by_body(measurement: Measurement, detector: int, threshold: float) -> Figure:
    """Success of trained colours and controls on each body, with 95 % intervals; of many bodies, sorted, without."""
    bodies = np.unique(measurement.trials.pose)
    if len(bodies) > MOST_BODIES:
        return _success_sorted(measurement, detector, threshold)
    height = max(2.9, 1.0 + (0.2 + 0.1 * len(measurement.controls)) * len(bodies))
    figure, (axis,) = new_figure(height=height)
    count = len(measurement.controls)
    for c, control in enumerate(measurement.controls):
        _, rates = group_rates(measurement, detector, c, measurement.trials.pose, threshold)
        at = np.arange(len(bodies)) + (c - (count - 1) / 2) * 0.7 / count
        value = np.array([r.value for r in rates])
        error = np.abs(np.array([[r.low, r.high] for r in rates]).T - value)
        look = SERIES[control]
        axis.errorbar(value, at, xerr=error, fmt=look.marker, color=look.color, label=look.label, lw=1.2, clip_on=False)
    percent_along_x(axis)
    axis.set_yticks(np.arange(len(bodies)), [measurement.body_names[int(p)] for p in bodies])
    axis.set_ylim(len(bodies) - 0.45, -0.55)
    axis.grid(axis="y", visible=False)
    legend_above(figure)
    return figure


def _success_sorted(measurement: Measurement, detector: int, threshold: float) -> Figure:
    """Success on every body, each pattern's bodies from its worst to its best."""
    figure, (axis,) = new_figure()
    pose = measurement.trials.pose
    for c, control in enumerate(measurement.controls):
        gone = measurement.score[detector, c] <= threshold
        rates = np.sort([gone[pose == body].mean() for body in np.unique(pose)])
        look = SERIES[control]
        at = np.arange(len(rates)) + 1
        axis.step(at, rates, where="mid", color=look.color, linestyle=look.dash, label=look.label)
    percent_axis(axis)
    axis.set_xlabel("bodies, from the worst to the best")
    legend_above(figure)
    return figure


def success_by_threshold(measurement: Measurement, detector: int, threshold: float) -> Figure:
    """Share of images without a person box above t, for every t: what another choice of threshold would have said."""
    figure, (axis,) = new_figure()
    grid = np.linspace(0, 1, 201)
    for c, control in enumerate(measurement.controls):
        score = np.sort(measurement.score[detector, c])
        look = SERIES[control]
        share = np.searchsorted(score, grid, side="right") / len(score)
        axis.plot(grid, share, color=look.color, linestyle=look.dash, label=look.label)
    axis.axvline(threshold, color="#1f2328", lw=0.8, ls=(0, (2, 2)))
    place = {"xytext": (4, 0), "textcoords": "offset points", "rotation": 90, "va": "center"}
    axis.annotate(f"threshold {threshold:g}", (threshold, 0.5), fontsize=8, **place)
    percent_axis(axis)
    axis.set_xlim(0, 1)
    axis.set_xlabel("detection threshold")
    legend_above(figure)
    return figure


def training_curves(losses: Curves, success: list[tuple[float, float]]) -> Figure:
    """Losses over the steps, and, where the run logged it, success on the training images."""
    panels = [bool(losses), bool(success)]
    figure, axes = new_figure(width=2 * WIDTH, columns=max(1, sum(panels)), height=2.8)
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


def _curve(axis: object, points: list[tuple[float, float]], color: str, label: str) -> None:
    """The points faintly, and their running mean over a fiftieth of them."""
    step, value = np.array(points, float).T
    window = max(1, len(value) // 50)
    if window > 1:
        axis.plot(step, value, color=color, lw=0.6, alpha=0.35)
        kernel = np.ones(window)
        value = np.convolve(value, kernel, "same") / np.convolve(np.ones(len(value)), kernel, "same")
    axis.plot(step, value, color=color, label=label)
