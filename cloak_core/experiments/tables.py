"""Tables of plain values as people read them, and what is told by comparing their rows."""

from __future__ import annotations

from collections.abc import Mapping

from cloak_core.studies.report.charts import SPECS, Rows, detector_names
from cloak_core.studies.report.words import interval, percent

HEADS = {
    "low": "95 % interval",
    "success_iou": "no box on body",
    "conditional": "where clean is found",
    "clothing": "own clothing",
    "average_precision": "AP",
    "clean_average_precision": "clean AP",
    "area_share": "area",
    "cpu_seconds": "CPU seconds",
    "gap": "gap to ours (points)",
    "image_rms": "image rms",
    "image_inside": "inside",
    "image_bias": "bias",
    "tv_weight": "weight",
    "success_own": "success at its own",
    "own_low": "95 % interval at its own",
    "clothing_own": "own clothing at its own",
    "grey_own": "grey at its own",
    "random_own": "random at its own",
    "false_alarms_own": "false alarms at its own",
    "ap50": "AP50",
    "clean_ap50": "clean AP50",
}
"""Of columns whose name says too little."""
FORMATS = dict.fromkeys(("mean_score", "image_rms", "image_inside"), "{:.3f}") | {"image_bias": "{:+.3f}"}
FORMATS |= dict.fromkeys(("angle", "distance", "tv_weight", "seconds", "cpu_seconds", "operating_point"), "{:g}")
"""Of numbers that are neither counts nor shares of one."""
INTERVALS = {"low": "high", "own_low": "own_high"}
"""Columns that hold the two ends of an interval."""


def readable(rows: Rows) -> dict[str, list]:
    """Write heads and cells as people read them: shares in per cent, the two ends of an interval in one column."""
    keys = [key for key in dict.fromkeys(key for row in rows for key in row) if key not in INTERVALS.values()]
    names = detector_names(rows)
    heads = [HEADS.get(key, key.replace("_", " ")) for key in keys]
    return {"heads": heads, "rows": [[cell(key, row, names) for key in keys] for row in rows]}


def cell(key: str, row: Mapping, names: Mapping[str, str]) -> str:
    """Write the value of one column of a row; names: of detectors, by spec."""
    value = row.get(key)
    if value is None:
        return "–"
    if key in INTERVALS:
        return interval([value, row[INTERVALS[key]]])
    if key in SPECS:
        return names[str(value)]
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (str, int)):
        return value if isinstance(value, str) else f"{value:,}"
    if key in FORMATS:
        return FORMATS[key].format(value)
    if key == "gap":
        return f"{100 * value:+.1f}".replace("-", "\N{MINUS SIGN}")
    return f"{100 * value:.1f} %" if key == "area_share" else percent(value)


# --- signs of a masked gradient (Athalye et al., ICML 2018): attacks that do better than the one that follows it

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
    """Add a column: whether an attack lies above the interval of the longest adaptive one with the same columns.

    Where there is none with them, it does not.
    """
    highest = {tuple(row[name] for name in same): row["high"] for row in longest_adaptive(rows, same)}
    key = lambda row: tuple(row[name] for name in same)
    return [row | {"beats_adaptive": row["success"] > highest.get(key(row), 1.0)} for row in rows]
