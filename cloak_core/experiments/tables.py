"""Tables of plain values as people read them: rows selected and grouped, cells in words, Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cloak_core.evaluation.report.words import interval, percent, short_names

Rows = list[dict]
"""Rows of a table: plain values by column."""
SPECS = ("detector", "trained_on", "tested_on")
"""Columns that hold detectors' specs."""
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


def select(rows: Rows, **values: object) -> Rows:
    """Select the rows with these values."""
    return [row for row in rows if all(row.get(key) == value for key, value in values.items())]


def group(rows: Rows, key: str) -> dict[Any, Rows]:
    """Group rows by their value in a column, in order; all in one group where `key` is empty."""
    if not key:
        return {"": rows} if rows else {}
    return {value: select(rows, **{key: value}) for value in dict.fromkeys(row[key] for row in rows)}


def column(rows: Rows, key: str = "success") -> list:
    """Select one column."""
    return [row[key] for row in rows]


def detector_names(rows: Rows) -> dict[str, str]:
    """Name the detectors of these rows shortly, by spec."""
    return short_names(str(row[key]) for row in rows for key in SPECS if row.get(key) is not None)


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


def markdown(rows: Rows) -> list[str]:
    """Write the lines of a Markdown table, and an empty one after it."""
    shown = readable(rows)
    lines = [shown["heads"], ["---"] * len(shown["heads"]), *shown["rows"]]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |" for cells in lines] + [""]
