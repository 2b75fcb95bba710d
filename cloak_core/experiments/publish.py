"""The experiments' tables and figures for people: one page, and Markdown for documentation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from cloak_core.core.evaluation.controls import LOGO
from cloak_core.core.pictures import open_picture, read_picture, save_picture
from cloak_core.experiments.runner import experiments, finished
from cloak_core.experiments.tables import readable
from cloak_core.files.reading import read_json
from cloak_core.files.specs import without_folders
from cloak_core.studies.report.page import data_uri, write_page

SHOWN, FOLDED = 40, 24
"""Rows of a table on the page, all of them being in numbers.csv; longer ones than the second are folded."""
ROWS, CURVES = 120, 30
"""Rows of the table of results in Markdown, and of the table of thresholds."""
LEFT_OUT = ("clean_detection", "false_alarms", "seeds", "worst_seed", "best_seed", "success_iou", "seconds")
"""Columns that a narrow table can spare."""
COLORS = 128
"""Of a published figure: plots have few, and the files stay small."""


def make_page(out: Path) -> Path:
    """Write OUT/index.html from the experiments in OUT and return its path. InputError: there is none."""
    records = finished(out)
    shown = [
        _shown(name, record, SHOWN)
        | {
            "figures": [figure(out / name / Path(f).name) for f in record["figures"] if not f.endswith(".svg")],
            "thresholds": readable(record.get("thresholds", [])[:SHOWN]),
            "folded": len(record["rows"]) > FOLDED,
        }
        for name, record in records.items()
    ]
    missing = [name for name in experiments() if name not in records]
    return write_page(out / "index.html", "experiments.html", {"experiments": shown, "missing": missing})


def _shown(name: str, record: dict, most: int, leave: Sequence[str] = ()) -> dict:
    """Prepare what both kinds of pages show of an experiment: at most `most` rows, without the columns `leave`."""
    rows = [{key: value for key, value in row.items() if key not in leave} for row in record["rows"][:most]]
    return {
        "name": name,
        "title": record["title"],
        "words": record["words"],
        "counts": record["counts"],
        "table": readable(rows),
        "left": max(0, len(record["rows"]) - most),
        "paper": readable(record["paper"]),
    }


def figure(path: Path) -> dict:
    """Read a figure as data, and the width in CSS pixels at which its text has the page's size."""
    with open_picture(path) as image:
        width = round(image.width / 200 * 118) if path.suffix == ".png" else image.width
        return {"data": data_uri(path), "width": width}


def publish(out: Path, folder: Path) -> Path:
    """Write FOLDER/tables.md, a section for every finished experiment of OUT, with plots beside it; returns its path.

    Plots only, no pictures: whether the photographs in those may be published only their owner knows.
    """
    records = finished(out)
    folder.mkdir(parents=True, exist_ok=True)
    shown = []
    for name, record in records.items():
        plots = [file for file in record["figures"] if file.endswith(".png")]
        config = read_json(out / name / "config.json")
        command = str(config.get("command", "")).replace(str(out), "OUT").replace(str(folder), "DOCS")
        rows = record["rows"][:ROWS]
        curves = record.get("thresholds", [])
        spread = [_spread(row) for row in rows if row.get("seeds", 1) > 1 and "worst_seed" in row]
        shown.append(
            _shown(name, record, ROWS, LEFT_OUT)
            | {
                "figures": [_copy(out / name / file, folder / f"{name}-{file}") for file in plots],
                "spread": readable(spread),
                "curves": readable([row for row in curves if row["control"] == LOGO][:CURVES]),
                "command": without_folders(command),
                "versions": {key: config[key] for key in ("cloak", "torch", "threads") if key in config},
            }
        )
    return write_page(folder / "tables.md", "experiments.md", {"experiments": shown})


def _copy(source: Path, target: Path) -> str:
    image = Image.fromarray(read_picture(source)).quantize(COLORS, dither=Image.Dither.NONE)
    save_picture(target, image, optimize=True)
    return target.name


def _spread(row: dict) -> dict:
    """Select a row's label, and the spread over its repetitions."""
    label = list(row)[: list(row).index("success")]
    return {key: row[key] for key in (*label, "seeds", "worst_seed", "best_seed")}
