"""Rows of plain values, as tables and figures are made of them: selected, grouped, and read from records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cloak_core.evaluation.report.words import short_names

Rows = list[dict]
"""Rows of a table: plain values by column."""
SPECS = ("detector", "trained_on", "tested_on")
"""Columns that hold detectors' specs."""


def rated(record: Mapping, name: str = "success", bounds: str = "ci95") -> dict:
    """Read a rate and its interval from a record, as columns of a row: success, low, high."""
    low, high = record[bounds]
    return {"success": record[name], "low": low, "high": high}


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
