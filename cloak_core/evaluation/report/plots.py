"""The plots of an evaluation, of its training, and of judged photographs. Call them inside `style.style`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cloak_core.evaluation.controls import LOGO
from cloak_core.evaluation.report.charts import Bars, Lines
from cloak_core.evaluation.report.rows import Rows, rated
from cloak_core.evaluation.report.style import CYCLE, WIDTH, new_figure, percent_axis
from cloak_core.evaluation.results import Results
from cloak_core.evaluation.statistics import by_value, hidden_rate, rate_row, share

Curves = dict[str, list[tuple[float, float]]]
"""Named curves of (step, value)."""
MOST_BODIES = 40
"""Bodies that a plot names one by one."""


def success_by_angle(results: Results, detector: str, threshold: float) -> Figure | None:
    """Plot success of the trained colours with its 95 % band, and of every control, over the azimuth."""
    return Lines(x="angle", series="control", size=(2 * WIDTH, 3.0)).draw(_rows(results, detector, "angle", threshold))


def success_by_distance(results: Results, detector: str, threshold: float) -> Figure | None:
    """Plot success over the camera's distance."""
    return Lines(x="distance", series="control").draw(_rows(results, detector, "distance", threshold))


def success_by_body(results: Results, detector: str, threshold: float) -> Figure | None:
    """Plot success of trained colours and controls on each body with intervals; of many bodies sorted, without."""
    many = results.trials["pose"].nunique() > MOST_BODIES
    rows = _rows(results, detector, "pose", threshold, () if many else results.controls)
    if not many:
        return Bars(y="body", series="control").draw([row | {"body": results.body_names[row["pose"]]} for row in rows])
    along = "bodies, from the worst to the best"
    ranked = [
        {"control": control, along: rank, "success": value}
        for control in results.controls
        for rank, value in enumerate(sorted(row["success"] for row in rows if row["control"] == control), 1)
    ]
    return Lines(x=along, series="control").draw(ranked)


def success_by_threshold(results: Results, detector: str, threshold: float) -> Figure | None:
    """Plot the share of images without a person box above t for every t; `threshold` is marked."""
    grid = np.linspace(0, 1, 201)
    rows = [
        {"control": control, "threshold": float(t), "success": float(value)}
        for control in results.controls
        for scores in [np.sort(results.scores(detector, control))]
        for t, value in zip(grid, np.searchsorted(scores, grid, side="right") / len(scores), strict=True)
    ]
    return Lines(x="threshold", series="control", mark=threshold).draw(rows)


def _rows(results: Results, detector: str, column: str, threshold: float, intervals: Sequence[str] = (LOGO,)) -> Rows:
    """Make a row for each control and value of a column: success, with its interval where asked for."""
    return [
        {"control": control, column: value.item()}
        | (rate_row(hidden_rate(rows, threshold)) if control in intervals else {})
        | {"success": share(rows, threshold), "n": len(rows)}
        for control in results.controls
        for value, rows in by_value(results.rows(detector, control), column)
    ]


def success_over_time(rows: Sequence[Mapping]) -> Figure | None:
    """Plot the rows of `over_time` over queries, where it was a search, else seconds, else steps."""
    along = next(key for key in ("queries", "seconds", "step") if all(row.get(key) is not None for row in rows))
    told = [
        {"detector": spec, along: row[along], **rated(record)}
        for row in rows
        for spec, record in row["detectors"].items()
    ]
    return Lines(x=along, series="detector").draw(told)


def found_by_distance(groups: Mapping[str, Mapping], labels: Mapping[str, str]) -> Figure | None:
    """Plot the share of people found over the distance (keys, metres), with and without the cloak.

    groups: by distance and by side ("with", "without"), a record with `detected`; labels: the sides' names.
    """
    rows = [
        {"picture": label, "distance": float(key), **rated(told[side], "detected", "ci95_detected")}
        for side, label in labels.items()
        for key, told in groups.items()
        if told[side]["detected"] is not None
    ]
    return Lines(x="distance", series="picture", rate="found").draw(rows)


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
