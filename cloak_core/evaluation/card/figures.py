"""The card's plots, from the card alone: each takes cards and returns a matplotlib figure."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.card.words import name_of
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.experiments.drawing import (
    band,
    compass,
    look,
    rate_bars,
    rates_along_x,
    ring,
    threshold_axis,
)
from cloak_core.evaluation.experiments.numbers import Rows
from cloak_core.evaluation.figures import INK, SERIES, WIDTH, legend_above, new_figure, percent_axis

RECALL_WAYS = {"distance": "distance (m)", "azimuth": "azimuth (degrees)", "elevation": "elevation (degrees)"}


def of(row: dict, key: str, bounds: str) -> dict:
    """A share as the drawing helpers take it."""
    low, high = row[bounds]
    return {"success": row[key], "low": low, "high": high}


def by_area(card: dict) -> Figure:
    """People hidden against the cloak's area, at both thresholds, and what the same patch does untrained."""
    figure, (axis,) = new_figure()
    rows = card["white_box"]
    at = [100 * row["area"] for row in rows]
    own = [of(row, "success_own", "ci95_own") for row in rows]
    band(axis, at, own, f"cloak, at the detector's own {card['operating_point']:g}", **look(0))
    band(axis, at, [of(row, "success", "ci95") for row in rows], f"cloak, at {THRESHOLD:g}", **look(1))
    for control in ("random", CLOTHING):
        series, values = SERIES[control], [row[f"{control}_own"] for row in rows]
        color = series.color if control == "random" else INK
        axis.plot(at, values, color=color, lw=1.2, ls=series.dash, marker=series.marker, ms=3, label=series.label)
    _area_axis(axis, at)
    legend_above(figure)
    return figure


def areas_of(cards: Sequence[dict]) -> Figure:
    """The same of several detectors, at the own threshold of each."""
    figure, (axis,) = new_figure(1.5 * WIDTH, 3.2)
    for k, card in enumerate(cards):
        rows = card["white_box"]
        if rows:
            own = [of(row, "success_own", "ci95_own") for row in rows]
            band(axis, [100 * row["area"] for row in rows], own, name_of(card), alpha=0.1, **look(k))
    _area_axis(axis, [100 * row["area"] for card in cards for row in card["white_box"]])
    if axis.get_legend_handles_labels()[0]:
        legend_above(figure)
    return figure


def _area_axis(axis: object, at: Sequence[float]) -> None:
    axis.set_xlim(0, 1.05 * max(at, default=100))
    axis.set_xlabel("share of the body's area (%)")
    percent_axis(axis, "people hidden")


def by_threshold(card: dict) -> Figure:
    """People hidden against the detection threshold, a line for each area."""
    figure, (axis,) = new_figure()
    for k, row in enumerate(card["white_box"]):
        values = row["by_threshold"]
        at = [float(t) for t in values]
        name = f"{100 * row['area']:.0f} % of the body, mean {100 * row['masr']:.0f} %"
        axis.plot(at, list(values.values()), label=name, clip_on=False, **look(k))
    percent_axis(axis, "people hidden")
    threshold_axis(axis)
    legend_above(figure)
    return figure


def around(card: dict) -> Figure:
    """People hidden in the full circle, seen from above."""
    figure, (polar,) = new_figure(WIDTH * 0.75, 4.0, subplot_kw={"projection": "polar"})
    rows = [{"angle": float(a)} | of(r, "success_own", "ci95_own") for a, r in card["around"]["by_angle"].items()]
    ring(polar, rows, "success", look(0)["color"], "-", "cloak for the full circle", banded=True)
    compass(polar)
    figure.legend(*polar.get_legend_handles_labels(), loc="outside upper left")
    return figure


def recall(cards: Sequence[dict]) -> Figure:
    """Recall in own clothing by distance, azimuth and elevation; a line for each detector."""
    figure, axes = new_figure(1.5 * WIDTH, 2.6, len(RECALL_WAYS), sharey=True)
    for axis, (way, name) in zip(axes, RECALL_WAYS.items(), strict=True):
        for k, card in enumerate(cards):
            rows = sorted(((float(v), r) for v, r in card["recall_by"][way].items()), key=lambda pair: pair[0])
            values = [of(r, "recall_own", "ci95_own") for _, r in rows]
            band(axis, [v for v, _ in rows], values, name_of(card), alpha=0.15 if len(cards) == 1 else 0.06, **look(k))
        axis.set_xlabel(name)
    percent_axis(axes[0], "found in own clothing")
    if len(cards) > 1:
        legend_above(figure)
    return figure


def bodies(card: dict) -> Figure:
    """Recall by body, and by pose, with intervals."""
    by = card["recall_by"]
    count = max(len(by["body"]), len(by["pose"]))
    figure, axes = new_figure(1.5 * WIDTH, max(1.6, 0.9 + 0.24 * count), 2)
    for axis, way in zip(axes, ("body", "pose"), strict=True):
        named = sorted(by[way].items(), key=lambda pair: pair[1]["recall_own"])[:20]
        _bars(axis, {name: of(row, "recall_own", "ci95_own") for name, row in named}, "found in own clothing")
        axis.set_title(f"by {way}" + (" (the 20 worst)" if len(by[way]) > 20 else ""))
    return figure


def controls(card: dict) -> Figure:
    """People hidden by patterns that nobody trained, on shirt and trousers."""
    named = {_control(name): of(row, "success_own", "ci95_own") for name, row in card["controls"].items()}
    figure, (axis,) = new_figure(height=0.9 + 0.28 * len(named))
    _bars(axis, named, "people hidden")
    return figure


def zoo(card: dict) -> Figure:
    """People hidden by cloaks that were made elsewhere."""
    rows = card["black_box"]["zoo"]
    named = {
        row["name"] + (" (made against it)" if row["trained_against_it"] else ""): of(row, "success_own", "ci95_own")
        for row in rows
    }
    figure, (axis,) = new_figure(height=1.0 + 0.28 * len(named))
    _bars(axis, named, "people hidden")
    return figure


def _bars(axis: object, named: dict[str, dict], label: str) -> None:
    rows: Rows = list(named.values())
    rates_along_x(axis, list(named))
    rate_bars(axis, rows, range(len(rows)), look(0)["color"])
    axis.set_xlabel(label)


def _control(name: str) -> str:
    return SERIES[name].label if name in SERIES else {"noise": "black and white"}.get(name, name)
