"""The plots of evaluations, trainings, judged photographs and matrices. Call them inside `style.style`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.statistics import hidden_rate, rate_row, success_rate
from cloak_core.studies.report.charts import Bars, Lines, Rows, rated
from cloak_core.studies.report.style import CYCLE, SERIES, WIDTH, new_figure, percent_axis
from cloak_core.studies.report.words import short_name
from cloak_core.studies.trained_run import History

MOST_BODIES = 40
"""Bodies that a plot names one by one."""
MOST_POINTS = 2000
"""Of a curve: a page has fewer pixels across."""
KINSHIPS = ("sibling", "stranger")
"""What files and `--json` call a judged detector: one of the same family as a surrogate, or of none."""
MARKS = dict(zip(KINSHIPS, ("", " *"), strict=True))
"""Beside the name of a judged detector, by its kinship."""


def evaluation_figures(results: Results, detector: str, threshold: float) -> dict[str, Figure | None]:
    """Plot success of the trained colours with its 95 % interval, and of every control, by title.

    By angle, distance and body where the images have these (several distances); by the detection threshold.
    """
    seen, figures = results.rows(detector, results.controls[0]), {}
    for column, least, size in (("angle", 1, (2 * WIDTH, 3.0)), ("distance", 2, Lines.size)):
        if seen[column].nunique() >= least:
            rows = _rows(results, detector, column, threshold)
            figures[f"Success by {column}"] = Lines(x=column, series="control", size=size).draw(rows)
    if seen["body"].nunique():
        figures["Success by body"] = success_by_body(results, detector, threshold)
    grid = np.linspace(0, 1, 201)
    curves = []
    for control in results.controls:
        scores = np.sort(results.scores(detector, control))
        # The share of images without a person box above each threshold.
        shares = np.searchsorted(scores, grid, side="right") / len(scores)
        values = zip(grid.tolist(), shares.tolist(), strict=True)
        curves += [{"control": control, "threshold": t, "success": value} for t, value in values]
    lines = Lines(x="threshold", series="control", mark=threshold)
    return figures | {"Success by threshold": lines.draw(curves)}


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


def _rows(results: Results, detector: str, column: str, threshold: float, intervals: Sequence[str] = (LOGO,)) -> Rows:
    """Make a row for each control and value of a column: success, with its interval where asked for."""
    return [
        {"control": control, column: value}
        | (rate_row(hidden_rate(rows, threshold)) if control in intervals else {})
        | {"success": success_rate(rows, threshold), "n": len(rows)}
        for control in results.controls
        for value, rows in results.rows(detector, control).groupby(column)
    ]


def success_over_time(rows: Sequence[Mapping]) -> Figure | None:
    """Plot the rows of `over_time` over queries, where it was a search, else seconds, else steps."""
    along = next(key for key in ("queries", "seconds", "step") if all(row.get(key) is not None for row in rows))
    points = [
        {"detector": spec, along: row[along], **rated(record)}
        for row in rows
        for spec, record in row["detectors"].items()
    ]
    return Lines(x=along, series="detector").draw(points)


def found_by_distance(groups: Mapping[str, Mapping], labels: Mapping[str, str]) -> dict[str, Figure | None]:
    """Plot the share of people found over several distances (keys, metres), with and without the cloak, by title.

    groups: by distance and by side ("with", "without"), a record with `detected`; labels: the sides' names.
    """
    rows = [
        {"picture": label, "distance": float(key), **rated(figures[side], "detected", "ci95_detected")}
        for side, label in labels.items()
        for key, figures in groups.items()
        if figures[side]["detected"] is not None
    ]
    return {"By distance": Lines(x="distance", series="picture", rate="found").draw(rows)} if len(groups) > 1 else {}


# --- training, and matrices


def training_curves(history: History) -> Figure | None:
    """Plot losses over the steps, and the success that training saw on its own images; None without either."""
    shown = {"Loss": history.losses, "Success on training images": {"success": history.success}}
    shown = {title: curves for title, curves in shown.items() if any(curves.values())}
    if not shown:
        return None
    figure, axes = new_figure(width=2 * WIDTH, columns=len(shown), height=2.8)
    for axis, (title, curves) in zip(axes, shown.items(), strict=True):
        for k, (name, points) in enumerate(curves.items()):
            _curve(axis, points, CYCLE[k % len(CYCLE)], name)
        axis.set_title(title)
        axis.set_xlabel("step")
        if title == "Loss":
            axis.set_ylim(bottom=0)
        else:
            percent_axis(axis, "")
        if len(curves) > 1:
            axis.legend()
    return figure


def _curve(axis: Axes, points: list[tuple[float, float]], color: str, label: str) -> None:
    """Draw the points faintly, of many the lowest and highest of each stretch, and their running mean over a fiftieth
    of them."""
    step, value = np.array(points, float).T
    window = max(1, len(value) // 50)
    starts = np.arange(0, len(value), -(-len(value) // MOST_POINTS))
    if window > 1:
        shown = [value] if len(starts) == len(value) else [f.reduceat(value, starts) for f in (np.minimum, np.maximum)]
        axis.plot(np.repeat(step[starts], len(shown)), np.stack(shown, 1).ravel(), color=color, lw=0.6, alpha=0.35)
        sums = np.concatenate([[0], np.cumsum(value)])
        first, end = (np.clip(starts + k, 0, len(value)) for k in (-(window // 2), window - window // 2))
        step, value = step[starts], (sums[end] - sums[first]) / (end - first)
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


def transfer_map(ladder: Mapping[str, Sequence[dict]]) -> Figure:
    """Plot success at 0.6 of every ablation by every judged detector, and below it the controls on the same images.

    ladder: the cells of a leave-one-out matrix by ablation. A single ablation is also shown at the other thresholds,
    and with the images in which nothing at all is reported on the body. The last column is the mean.
    """
    last = {cell["judged"]: cell for own in ladder.values() for cell in own}
    kinds = {"": " at 0.6", "_own": " at its own", "_025": " at 0.25"} if len(ladder) == 1 else {"": ""}
    rows = {
        ablation + words: {cell["judged"]: cell[f"success{suffix}"] for cell in own}
        for ablation, own in ladder.items()
        for suffix, words in kinds.items()
    }
    if len(ladder) == 1:
        rows["nothing reported at 0.6"] = {name: cell.get("gone") for name, cell in last.items()}
    for control in ("random", CLOTHING):
        rows[SERIES[control]["label"]] = {name: cell[control] for name, cell in last.items()}
    shares = pd.DataFrame(rows, index=list(last), dtype=float).T
    shares = shares.assign(mean=shares.mean(axis=1))
    columns = [*(short_name(name) + MARKS[cell["kin"]] for name, cell in last.items()), "mean"]
    figure = heat_map(shares.to_numpy(), list(rows), columns, rule=len(rows) - 2)
    (axis,) = figure.axes
    axis.axvline(len(columns) - 1.5, color="white", lw=3)
    axis.set_xlabel("judged by (left out of training)")
    return figure
