"""Signs of a masked gradient (Athalye et al., ICML 2018): attacks that do better than the one that follows it."""

from __future__ import annotations

from cloak_core.experiments.tables import Rows

ADAPTIVE = "adaptive"


def longest_adaptive(rows: Rows, same: tuple[str, ...] = ("detector", "logo")) -> Rows:
    """Select the longest adaptive attack among rows that have the columns `same` in common."""
    kept: dict[tuple, dict] = {}
    for row in rows:
        key = tuple(row[name] for name in same)
        if row["attack"] == ADAPTIVE and row.get("steps", 0) >= kept.get(key, row).get("steps", 0):
            kept[key] = row
    return list(kept.values())


def beats_adaptive(rows: Rows, same: tuple[str, ...]) -> Rows:
    """Add a column: whether an attack lies above the interval of the longest adaptive one with the same columns."""
    highest = {tuple(row[name] for name in same): row["high"] for row in longest_adaptive(rows, same)}
    return [row | {"beats_adaptive": row["success"] > highest[tuple(row[name] for name in same)]} for row in rows]
