"""Numbers of experiments in words."""

from __future__ import annotations

import re

from cloak_core.evaluate.intervals import Rate
from cloak_core.evaluate.report.words import interval, percent, short_name


def said(row: dict) -> str:
    """A table row's success with interval and count."""
    return f"{percent(row['success'])} (95 % interval {interval([row['low'], row['high']])}, n = {row['n']:,})"


def said_rate(rate: Rate) -> str:
    """A rate with interval and count."""
    return f"{percent(rate.value)} (95 % interval {interval([rate.low, rate.high])}, n = {rate.n:,})"


def rate_text(value: float | None) -> str:
    """A share as percent."""
    return percent(value)


def file_name(spec: str) -> str:
    """A detector's name as part of a file's."""
    return re.sub(r"[^a-z0-9]+", "-", short_name(spec).lower()).strip("-")


def best_row(rows: list[dict]) -> dict:
    """The row with the highest success."""
    return max(rows, key=lambda row: row["success"])
