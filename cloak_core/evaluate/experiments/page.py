"""One page that gathers the experiments' figures, tables and words next to the paper's values."""

from __future__ import annotations

import os
from pathlib import Path

from markupsafe import Markup

from cloak_core.errors import InputError
from cloak_core.evaluate.experiments.registry import EXPERIMENTS, finished
from cloak_core.evaluate.report.page import HERE as REPORT
from cloak_core.evaluate.report.page import data_uri, environment

HERE = Path(__file__).parent
SHOWN = 40
"""Rows of a table on the page; all of them are in numbers.csv."""
COLUMNS = {
    "success": "success",
    "low": "low",
    "high": "high",
    "n": "n",
    "success_iou": "no box on body",
    "conditional": "where clean is found",
    "clothing": "own clothing",
    "clean_detection": "clean detection",
    "average_precision": "AP",
    "clean_average_precision": "clean AP",
    "area_share": "area",
    "false_alarms": "false alarms",
    "tv_weight": "weight",
    "worst_seed": "worst seed",
    "best_seed": "best seed",
}
SHARES = {"success", "low", "high", "success_iou", "conditional", "clothing", "grey", "random", "stripes", "checks"} | {
    "clean_detection", "average_precision", "clean_average_precision", "area_share", "false_alarms", "reach",
    "worst_seed", "best_seed", "single", "multi",
}  # fmt: skip
"""Columns that are shares of one."""


def make_page(out: Path) -> Path:
    """Write OUT/index.html from the experiments in OUT and return its path. InputError where there is none."""
    records = finished(out)
    if not records:
        raise InputError(f"{out}: holds no finished experiment")
    experiments = [
        {
            "name": name,
            "title": record["title"],
            "words": record["words"],
            "figures": [data_uri(out / name / Path(f).name) for f in record["figures"] if f.endswith(".png")],
            "table": table(record["rows"][:SHOWN]),
            "left": max(0, len(record["rows"]) - SHOWN),
            "paper": table(record["paper"]),
            "counts": record["counts"],
        }
        for name, record in records.items()
    ]
    text = (
        environment(HERE)
        .get_template("experiments.html")
        .render(
            css=Markup((REPORT / "style.css").read_text("utf-8")),
            experiments=experiments,
            missing=[name for name in EXPERIMENTS if name not in records],
        )
    )
    page = out / "index.html"
    temporary = out / ".index.html"
    temporary.write_text(text, "utf-8")
    os.replace(temporary, page)
    return page


def table(rows: list[dict]) -> tuple[list[str], list[list[str]]]:
    """Heads and cells of a table, shares as percent."""
    keys = list(dict.fromkeys(key for row in rows for key in row))
    return [COLUMNS.get(key, key.replace("_", " ")) for key in keys], [
        [cell(key, row.get(key)) for key in keys] for row in rows
    ]


def cell(key: str, value: object) -> str:
    """A value as a table shows it."""
    if value is None:
        return "–"
    if key in SHARES and isinstance(value, (int, float)):
        return f"{100 * value:.1f} %" if value < 0.1 or key == "area_share" else f"{100 * value:.0f} %"
    if isinstance(value, float):
        return f"{value:g}"
    return f"{value:,}" if isinstance(value, int) else str(value)
