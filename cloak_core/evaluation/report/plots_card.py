"""The plots of robustness cards, from the cards alone. Call them inside `style.style`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.card.leaderboard import name_of
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.intervals import Rate
from cloak_core.evaluation.report.plots import (
    band,
    compass,
    numbered_series,
    rate_bars,
    rates_along_x,
    read_rates,
    ring,
    threshold_axis,
    values,
)
from cloak_core.evaluation.report.style import INK, SERIES, WIDTH, legend_above, new_figure, percent_axis

Plot = Callable[[], Figure]
RECALL_WAYS = {"distance": "distance (m)", "azimuth": "azimuth (degrees)", "elevation": "elevation (degrees)"}
MOST_BARS = 20
"""Bodies and poses that are named."""


def card_figures(card: dict) -> dict[str, Plot]:
    """Name the plots of one card; those that it has figures for."""
    zoo = card["black_box"]["zoo"]
    against = lambda row: row["name"] + (" (made against it)" if row["trained_against_it"] else "")
    controls = {_control(name): row for name, row in card["controls"].items()}
    plots = {
        "recall": partial(recall, [card]),
        "bodies": partial(recall_bars, card),
        "controls": partial(hidden_bars, controls, 0.9),
    }
    if card["white_box"]:
        plots |= {"area": partial(by_area, card), "threshold": partial(by_threshold, card)}
    if card.get("around"):
        plots["around"] = partial(around, card)
    if zoo:
        plots["zoo"] = partial(hidden_bars, {against(row): row for row in zoo}, 1.0)
    return plots


def comparison_figures(cards: Sequence[dict]) -> dict[str, Plot]:
    """Name the plots that compare cards, by their titles."""
    return {
        "People hidden against the cloak's area, at each one's own threshold": partial(compare_areas, cards),
        "Found in own clothing": partial(recall, cards),
    }


def by_area(card: dict) -> Figure:
    """Plot people hidden over the cloak's area, at both thresholds, and what the same faces do untrained."""
    figure, (axis,) = new_figure()
    rows = card["white_box"]
    at = [100 * row["area"] for row in rows]
    own = f"cloak, at the detector's own {card['operating_point']:g}"
    band(axis, at, _own_rates(rows, "success"), own, **numbered_series(0))
    band(axis, at, read_rates(rows, "success", "ci95"), f"cloak, at {THRESHOLD:g}", **numbered_series(1))
    for control, color in (("random", SERIES["random"].color), (CLOTHING, INK)):
        series = SERIES[control]
        look = {"ls": series.dash, "marker": series.marker, "label": series.label}
        axis.plot(at, [row[f"{control}_own"] for row in rows], color=color, lw=1.2, ms=3, **look)
    _area_axis(axis, at)
    legend_above(figure)
    return figure


def compare_areas(cards: Sequence[dict]) -> Figure:
    """Plot people hidden from several detectors over the cloak's area, at the own threshold of each."""
    figure, (axis,) = new_figure(1.5 * WIDTH, 3.2)
    for k, card in enumerate(cards):
        rows = card["white_box"]
        at = [100 * row["area"] for row in rows]
        if rows:
            band(axis, at, _own_rates(rows, "success"), name_of(card), alpha=0.1, **numbered_series(k))
    _area_axis(axis, [100 * row["area"] for card in cards for row in card["white_box"]])
    legend_above(figure)
    return figure


def by_threshold(card: dict) -> Figure:
    """Plot people hidden over the detection threshold, a line for each area."""
    figure, (axis,) = new_figure()
    for k, row in enumerate(card["white_box"]):
        curve = {float(t): value for t, value in row["by_threshold"].items()}
        name = f"{100 * row['area']:.0f} % of the body, mean {100 * row['masr']:.0f} %"
        axis.plot(list(curve), list(curve.values()), label=name, clip_on=False, **numbered_series(k))
    percent_axis(axis, "people hidden")
    threshold_axis(axis)
    legend_above(figure)
    return figure


def around(card: dict) -> Figure:
    """Plot people hidden in the full circle, seen from above."""
    figure, (polar,) = new_figure(WIDTH * 0.75, 4.0, subplot_kw={"projection": "polar"})
    by_angle = card["around"]["by_angle"]
    rates = _own_rates(list(by_angle.values()), "success")
    look = {"color": numbered_series(0)["color"], "ls": "-", "lw": 1.8, "label": "cloak for the full circle"}
    ring(polar, [float(angle) for angle in by_angle], values(rates).tolist(), rates, **look)
    compass(polar)
    figure.legend(*polar.get_legend_handles_labels(), loc="outside upper left")
    return figure


def recall(cards: Sequence[dict]) -> Figure:
    """Plot recall in own clothing by distance, azimuth and elevation; a line for each detector."""
    figure, axes = new_figure(1.5 * WIDTH, 2.6, len(RECALL_WAYS), sharey=True)
    for axis, (way, label) in zip(axes, RECALL_WAYS.items(), strict=True):
        for k, card in enumerate(cards):
            rows = {float(value): row for value, row in card["recall_by"][way].items()}
            at, alpha = sorted(rows), 0.15 if len(cards) == 1 else 0.06
            rates = _own_rates([rows[value] for value in at], "recall")
            band(axis, at, rates, name_of(card), alpha=alpha, **numbered_series(k))
        axis.set_xlabel(label)
    percent_axis(axes[0], "found in own clothing")
    if len(cards) > 1:
        legend_above(figure)
    return figure


def recall_bars(card: dict) -> Figure:
    """Plot recall in own clothing by body, and by pose, with intervals."""
    ways = {way: card["recall_by"][way] for way in ("body", "pose")}
    figure, axes = new_figure(1.5 * WIDTH, max(1.6, 0.9 + 0.24 * max(map(len, ways.values()))), 2)
    for axis, (way, rows) in zip(axes, ways.items(), strict=True):
        worst = dict(sorted(rows.items(), key=lambda pair: pair[1]["recall_own"])[:MOST_BARS])
        _bars(axis, list(worst), _own_rates(list(worst.values()), "recall"), "found in own clothing")
        axis.set_title(f"by {way}" + (f" (the {MOST_BARS} worst)" if len(rows) > MOST_BARS else ""))
    return figure


def hidden_bars(rows: Mapping[str, dict], head: float) -> Figure:
    """Plot people hidden, a bar for each named row; `head`: height beside the bars, inches."""
    figure, (axis,) = new_figure(height=head + 0.28 * len(rows))
    _bars(axis, list(rows), _own_rates(list(rows.values()), "success"), "people hidden")
    return figure


def _own_rates(rows: Sequence[dict], name: str) -> list[Rate]:
    return read_rates(rows, f"{name}_own", "ci95_own")


def _bars(axis: Axes, names: Sequence[str], rates: Sequence[Rate], label: str) -> None:
    rates_along_x(axis, names, label)
    rate_bars(axis, rates, range(len(rates)), numbered_series(0)["color"])


def _area_axis(axis: Axes, at: Sequence[float]) -> None:
    axis.set_xlim(0, 1.05 * max(at, default=100))
    axis.set_xlabel("share of the body's area (%)")
    percent_axis(axis, "people hidden")


def _control(name: str) -> str:
    return SERIES[name].label if name in SERIES else {"noise": "black and white"}.get(name, name)
