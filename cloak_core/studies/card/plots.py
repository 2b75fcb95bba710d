"""The plots of robustness cards, one by one and side by side. Call them inside `style.style`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from matplotlib.figure import Figure

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.evaluation import CLOTHING
from cloak_core.studies.card.words import name_of
from cloak_core.studies.report.charts import Bars, Lines, Rings, Rows, rated
from cloak_core.studies.report.style import SERIES, WIDTH

RECALL_WAYS = {"distance": "distance (m)", "azimuth": "azimuth (degrees)", "elevation": "elevation (degrees)"}
MOST_BARS = 20
"""Bodies and poses that are named."""
HIDDEN, FOUND = "people hidden", "found in own clothing"
WIDE = (1.5 * WIDTH, 3.2)
BARS = Bars(y="name", rate=HIDDEN)


def card_figures(card: dict) -> dict[str, Figure | None]:
    """Draw one card, by the names that its page knows: people found, and people hidden; what it has figures for."""
    figures = {"recall": recall([card])}
    for way in ("body", "pose"):
        worst = sorted(card["recall_by"][way].items(), key=lambda pair: pair[1]["recall_own"])[:MOST_BARS]
        figures[f"by_{way}"] = Bars(y="name", rate=FOUND).draw(_own_rows("name", worst, "recall"))
    called = {name: series.label for name, series in SERIES.items()} | {"noise": "black and white"}
    controls = [(called.get(name, name), row) for name, row in card["controls"].items()]
    figures["controls"] = BARS.draw(_own_rows("name", controls))
    if zoo := card["black_box"]["zoo"]:
        against = [(row["name"] + " (made against it)" * bool(row["trained_against_it"]), row) for row in zoo]
        figures["zoo"] = BARS.draw(_own_rows("name", against))
    if card["white_box"]:
        figures |= {"area": by_area(card), "threshold": by_threshold(card)}
    if card.get("around"):
        by_angle = _own_rows("angle", [(float(angle), row) for angle, row in card["around"]["by_angle"].items()])
        label = {"cloak": "cloak for the full circle"}
        figures["around"] = Rings(series="cloak").draw([label | row for row in by_angle])
    return figures


def comparison_figures(cards: Sequence[dict]) -> dict[str, Figure | None]:
    """Draw what compares cards, by title: people hidden over the cloak's area, each at its own threshold; recall."""
    rows = [
        {"name": name_of(card), "area_share": row["area"], **rated(row, "success_own", "ci95_own")}
        for card in cards
        for row in card["white_box"]
    ]
    lines = Lines(x="area_share", series="name", rate=HIDDEN, size=WIDE)
    area = "People hidden against the cloak's area, at each one's own threshold"
    return ({area: lines.draw(rows)} if rows else {}) | {"Found in own clothing": recall(cards)}


def by_area(card: dict) -> Figure | None:
    """Plot people hidden over the cloak's area, at both thresholds, and what the same faces do untrained."""
    beside = {"at_0.6": f"cloak, at {THRESHOLD:g}"}
    beside |= {f"{control}_own": SERIES[control].label for control in ("random", CLOTHING)}
    rows = [
        row
        | {"at": f"cloak, at the detector's own {card['operating_point']:g}"}
        | {"at_0.6": row["success"], "area_share": row["area"], **rated(row, "success_own", "ci95_own")}
        for row in card["white_box"]
    ]
    return Lines(x="area_share", series="at", beside=beside, rate=HIDDEN).draw(rows)


def by_threshold(card: dict) -> Figure | None:
    """Plot people hidden over the detection threshold, a line for each area."""
    rows = [
        {"cloak": f"{100 * row['area']:.0f} % of the body, mean {100 * row['masr']:.0f} %"}
        | {"threshold": float(t), "success": value}
        for row in card["white_box"]
        for t, value in row["by_threshold"].items()
    ]
    return Lines(x="threshold", series="cloak", rate=HIDDEN).draw(rows)


def recall(cards: Sequence[dict]) -> Figure | None:
    """Plot recall in own clothing by distance, azimuth and elevation; a line for each detector."""
    rows = [
        {"name": name_of(card), "way": label, **row}
        for way, label in RECALL_WAYS.items()
        for card in cards
        for row in _own_rows("", ((float(value), row) for value, row in card["recall_by"][way].items()), "recall")
    ]
    return Lines(x="", series="name", panel="way", rate=FOUND, size=WIDE).draw(rows)


def _own_rows(column: str, records: Iterable[tuple[object, dict]], name: str = "success") -> Rows:
    """Make rows of labelled records: the rate at the detector's own threshold, with its interval."""
    return [{column: label, **rated(record, f"{name}_own", "ci95_own")} for label, record in records]
