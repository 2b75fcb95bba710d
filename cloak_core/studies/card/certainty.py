"""How sure a card's figures are: the one rule for headline, tiles, tables, terminal, gate and leaderboard.

A figure is "measured"; or "at least" as much, where the attack behind it was shorter than the protocol asks for or
followed a part of the gradient alone; or "not measured".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from cloak_core.core.evaluation.controls import CLOTHING
from cloak_core.studies.card.protocol import AGAINST, updates_needed
from cloak_core.studies.report.words import percent
from cloak_core.zoo.entry import MARK

MEASURED, AT_LEAST, NOT_MEASURED = "measured", "at least", "not measured"
UNTRAINED = (CLOTHING, "grey", "random", "resampled")
"""What people in photographs wear as controls."""
HALF = 0.5


@dataclass(frozen=True)
class Attack:
    """An attack of a card, and what it did."""

    worn: str
    """In words: "a cloak on 76 % of the body, made against it"."""
    row: dict
    photographed: bool
    in_photographs: str = ""
    """Of an attack on rendered bodies: what people in photographs call the same cloth; "" where they never wear it."""


def state_of_attack(steps: int, area: float | None, partial_gradient: str) -> str:
    """Tell how sure an attack against the detector itself is. area: None for the cloak for all around."""
    return AT_LEAST if steps < updates_needed(area) or partial_gradient else MEASURED


def state(row: dict | None) -> str:
    """Tell how sure a row of a card is; one that is not there was not measured."""
    return NOT_MEASURED if not row else row["state"]


def shown(row: dict | None, key: str = "success_own") -> str:
    """Write a share for tiles and tables: "55 %", "≥ 55 %", or "–" where it was not measured."""
    if state(row) == NOT_MEASURED:
        return "–"
    return f"{'≥ ' if state(row) == AT_LEAST else ''}{percent(row[key])}"


def worded(row: dict, whole: str = MEASURED) -> str:
    """Write a share of hidden people for sentences: "55 %" or "at least 55 %". whole: how sure the card is at all."""
    return f"{'at least ' if AT_LEAST in (state(row), whole) else ''}{percent(row['success_own'])}"


def whole(card: dict) -> str:
    """Tell how sure a card is of the strongest attack: at most "at least" without a white box that was measured."""
    sure = bool(card["white_box"]) and all(state(row) == MEASURED for row in card["white_box"])
    return MEASURED if sure else AT_LEAST if any(attacks(card)) else NOT_MEASURED


def attacks(card: dict) -> Iterator[Attack]:
    """List every attack of a card: on people in photographs, then on rendered bodies."""
    for name, row in worn_rows(card).items():
        yield Attack(_worn(name), row, True)
    for k, row in enumerate(card["white_box"], 1):
        worn = AGAINST * (k == len(card["white_box"]))
        yield Attack(f"a cloak on {percent(row['area'])} of the body, made against it,", row, False, worn)
    if card.get("around"):
        yield Attack("a cloak for all sides, made against it,", card["around"], False)
    for row in card.get("patterns") or []:
        yield Attack(f"the pattern {row['name'].partition('@')[0]}", row, False, row["name"])
    for row in card["black_box"]["zoo"]:
        if not row["trained_against_it"]:
            yield Attack(f"{row['name']}, made against other detectors,", row, False, MARK + row["name"])


def strongest(card: dict, photographed: bool | None = None) -> Attack | None:
    """Find the attack that hides most people at the detector's own threshold; of equal ones, the photographs'."""
    chosen = [one for one in attacks(card) if photographed in (None, one.photographed)]
    return max(chosen, key=lambda one: one.row["success_own"], default=None)


def kind(card: dict) -> str:
    """Judge a card for whoever runs the detector.

    bad: an attack hides half of the people or more. good: the white box was measured, and no interval of any attack
    reaches half. unknown: else.
    """
    most = strongest(card)
    if most is not None and most.row["success_own"] >= HALF:
        return "bad"
    sure = whole(card) == MEASURED and all(one.row["ci95_own"][1] < HALF for one in attacks(card))
    return "good" if sure else "unknown"


def worn_rows(card: dict) -> dict[str, dict]:
    """Select what people in photographs wore beside the controls: name -> S; empty where there were none."""
    rows = (card.get("photographs") or {}).get("rows", {})
    return {name: row for name, row in rows.items() if name not in UNTRAINED}


def _worn(name: str) -> str:
    if name == AGAINST:
        return "a cloak made against it"
    return f"the pattern {name.partition('@')[0]}" if "@" in name else f"{name}, made against other detectors,"
