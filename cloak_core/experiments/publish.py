"""The experiments' tables and figures: a page for people, and rows for the project's records."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from cloak_core.core.evaluation.controls import LOGO
from cloak_core.core.pictures import open_picture
from cloak_core.experiments.runner import experiments, finished
from cloak_core.experiments.tables import readable
from cloak_core.files.reading import read_json
from cloak_core.studies.report.charts import Rows, publish_rows
from cloak_core.studies.report.page import data_uri, write_page

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
