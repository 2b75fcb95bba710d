"""The experiments' tables and figures: a page for people, and rows for the project's records."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from cloak_core.core.evaluation import LOGO
from cloak_core.core.pictures import open_picture
from cloak_core.experiments.runner import experiments, finished
from cloak_core.files.reading import read_json
from cloak_core.studies.report.charts import SPECS, Rows, detector_names, publish_rows
from cloak_core.studies.report.page import data_uri, write_page
from cloak_core.studies.report.words import interval, percent

SHOWN, FOLDED = 40, 24
"""Rows of a table on the page, all of them being in numbers.csv; longer ones than the second are folded."""
MADE = ("command", "date", "cloak", "torch", "platform", "threads")
"""Of config.json, kept beside published rows."""


def make_page(out: Path) -> Path:
    """Write OUT/index.html from the experiments in OUT and return its path. InputError: there is none."""
    records = finished(out)
    shown = [
        {
            "name": name,
            "title": record["title"],
            "words": record["words"],
            "counts": record["counts"],
            "table": readable(record["rows"][:SHOWN]),
            "left": max(0, len(record["rows"]) - SHOWN),
            "paper": readable(record["paper"]),
            "figures": [figure(out / name / Path(f).name) for f in record["figures"] if not f.endswith(".svg")],
            "thresholds": readable(record.get("thresholds", [])[:SHOWN]),
            "folded": len(record["rows"]) > FOLDED,
        }
        for name, record in records.items()
    ]
    missing = [name for name in experiments() if name not in records]
    return write_page(out / "index.html", "experiments.html", {"experiments": shown, "missing": missing})


def figure(path: Path) -> dict:
    """Read a figure as data, and the width in CSS pixels at which its text has the page's size."""
    with open_picture(path) as image:
        width = round(image.width / 200 * 118) if path.suffix == ".png" else image.width
        return {"data": data_uri(path), "width": width}


def publish(out: Path, folder: Path) -> Path:
    """Put every finished experiment's rows into FOLDER/NAME.csv, under the name of the folder OUT; returns FOLDER."""
    for name, record in finished(out).items():
        config = read_json(out / name / "config.json")
        made = {key: config[key] for key in MADE if key in config} | record["counts"]
        publish_rows(folder, name, out.resolve().name, with_curves(record), made)
    return folder


def with_curves(record: dict) -> Rows:
    """Add success at other thresholds to an experiment's rows: columns at_0.1 to at_0.9 where it was measured."""
    if not record.get("thresholds"):
        return record["rows"]
    curves = pd.DataFrame([row for row in record["thresholds"] if row["control"] == LOGO], dtype=object)
    rows = pd.DataFrame(record["rows"], dtype=object).merge(curves.drop(columns="control"), how="left")
    return rows.to_dict("records")


# --- tables of plain values as people read them

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
