"""The plots of robustness cards, from the cards alone. Call them inside `style.style`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from matplotlib.figure import Figure

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.card.leaderboard import name_of
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.report.charts import Bars, Lines, Rings
from cloak_core.evaluation.report.rows import rated
from cloak_core.evaluation.report.style import SERIES, WIDTH

Plot = Callable[[], Figure | None]
RECALL_WAYS = {"distance": "distance (m)", "azimuth": "azimuth (degrees)", "elevation": "elevation (degrees)"}
MOST_BARS = 20
"""Bodies and poses that are named."""
HIDDEN, FOUND = "people hidden", "found in own clothing"
WIDE = (1.5 * WIDTH, 3.2)


def card_figures(card: dict) -> dict[str, Plot]:
    """Name the plots of one card; those that it has figures for."""
    zoo = card["black_box"]["zoo"]
    against = lambda row: row["name"] + (" (made against it)" if row["trained_against_it"] else "")
    plots = {
        "recall": partial(recall, [card]),
        "by_body": partial(recall_bars, card, "body"),
        "by_pose": partial(recall_bars, card, "pose"),
        "controls": partial(hidden_bars, {_control(name): row for name, row in card["controls"].items()}),
    }
    if card["white_box"]:
        plots |= {"area": partial(by_area, card), "threshold": partial(by_threshold, card)}
    if card.get("around"):
        plots["around"] = partial(around, card)
    if zoo:
        plots["zoo"] = partial(hidden_bars, {against(row): row for row in zoo})
    return plots


def comparison_figures(cards: Sequence[dict]) -> dict[str, Plot]:
    """Name the plots that compare cards, by their titles."""
    area = "People hidden against the cloak's area, at each one's own threshold"
    attacked = {area: partial(compare_areas, cards)} if any(card["white_box"] for card in cards) else {}
    return attacked | {"Found in own clothing": partial(recall, cards)}


def by_area(card: dict) -> Figure | None:
    """Plot people hidden over the cloak's area, at both thresholds, and what the same faces do untrained."""
    beside = {"at_0.6": f"cloak, at {THRESHOLD:g}"}
    beside |= {f"{control}_own": SERIES[control].label for control in ("random", CLOTHING)}
    rows = [
        row
        | {"at_0.6": row["success"], "at": f"cloak, at the detector's own {card['operating_point']:g}"}
        | {"area_share": row["area"]}
        | _own(row, "success")
        for row in card["white_box"]
    ]
    return Lines(x="area_share", series="at", beside=beside, rate=HIDDEN).draw(rows)


def compare_areas(cards: Sequence[dict]) -> Figure | None:
    """Plot people hidden from several detectors over the cloak's area, at the own threshold of each."""
    rows = [
        {"name": name_of(card), "area_share": row["area"], **_own(row, "success")}
        for card in cards
        for row in card["white_box"]
    ]
    return Lines(x="area_share", series="name", rate=HIDDEN, size=WIDE).draw(rows)


def by_threshold(card: dict) -> Figure | None:
    """Plot people hidden over the detection threshold, a line for each area."""
    rows = [
        {"cloak": f"{100 * row['area']:.0f} % of the body, mean {100 * row['masr']:.0f} %"}
        | {"threshold": float(t), "success": value}
        for row in card["white_box"]
        for t, value in row["by_threshold"].items()
    ]
    return Lines(x="threshold", series="cloak", rate=HIDDEN).draw(rows)


def around(card: dict) -> Figure | None:
    """Plot people hidden in the full circle, seen from above."""
    label = {"cloak": "cloak for the full circle"}
    by_angle = card["around"]["by_angle"]
    rows = [label | {"angle": float(angle), **_own(row, "success")} for angle, row in by_angle.items()]
    return Rings(series="cloak").draw(rows)


def recall(cards: Sequence[dict]) -> Figure | None:
    """Plot recall in own clothing by distance, azimuth and elevation; a line for each detector."""
    rows = [
        {"name": name_of(card), "way": label, "": float(value), **_own(row, "recall")}
        for way, label in RECALL_WAYS.items()
        for card in cards
        for value, row in card["recall_by"][way].items()
    ]
    return Lines(x="", series="name", panel="way", rate=FOUND, size=WIDE).draw(rows)


def recall_bars(card: dict, way: str) -> Figure | None:
    """Plot recall in own clothing by body or by pose, with intervals; of many those where it is lowest."""
    worst = sorted(card["recall_by"][way].items(), key=lambda pair: pair[1]["recall_own"])[:MOST_BARS]
    return Bars(y="name", rate=FOUND).draw([{"name": name, **_own(row, "recall")} for name, row in worst])


def hidden_bars(rows: Mapping[str, dict]) -> Figure | None:
    """Plot people hidden, a bar for each named row."""
    return Bars(y="name", rate=HIDDEN).draw([{"name": name, **_own(row, "success")} for name, row in rows.items()])


def _own(record: dict, name: str) -> dict:
    """Read a rate at the detector's own threshold, with its interval."""
    return rated(record, f"{name}_own", "ci95_own")


def _control(name: str) -> str:
    return SERIES[name].label if name in SERIES else {"noise": "black and white"}.get(name, name)
