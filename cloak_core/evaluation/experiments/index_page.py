"""One page that gathers the experiments' figures, tables and words next to the paper's values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from markupsafe import Markup

from cloak_core.evaluation.experiments.registry import EXPERIMENTS, finished
from cloak_core.evaluation.report.page import HERE as REPORT
from cloak_core.evaluation.report.page import data_uri, environment
from cloak_core.evaluation.report.words import interval, percent, short_names
from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_TEXT_BYTES, read_text
from cloak_core.files.writing import write_text
from cloak_core.scene.pictures import open_picture

HERE = Path(__file__).parent
SHOWN = 40
"""Rows of a table on the page; all of them are in numbers.csv."""
FOLDED = 24
"""Tables longer than this are folded."""
HEADS = {
    "success_iou": "no box on body",
    "conditional": "where clean is found",
    "mean_score": "mean score",
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
FORMATS = {
    "mean_score": "{:.3f}",
    "image_rms": "{:.3f}",
    "image_inside": "{:.3f}",
    "image_bias": "{:+.3f}",
} | dict.fromkeys(("angle", "distance", "tv_weight", "seconds", "cpu_seconds", "operating_point"), "{:g}")
"""Of numbers that are neither counts nor shares of one."""
INTERVALS = {"low": "high", "own_low": "own_high"}
"""Columns that hold the two ends of an interval."""
SPECS = {"detector", "trained_on", "tested_on"}


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
            "figures": [figure(out / name / Path(f).name) for f in record["figures"] if not f.endswith(".svg")],
            "table": table(record["rows"][:SHOWN]),
            "thresholds": table(record.get("thresholds", [])[:SHOWN]),
            "folded": len(record["rows"]) > FOLDED,
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
            css=Markup(read_text(REPORT / "style.css", MAX_TEXT_BYTES)),
            experiments=experiments,
            missing=[name for name in EXPERIMENTS if name not in records],
        )
    )
    page = out / "index.html"
    write_text(page, text)
    return page


def figure(path: Path) -> dict:
    """A figure as data, and the width in CSS pixels at which its text has the page's size."""
    with open_picture(path) as image:
        width = round(image.width / 200 * 118) if path.suffix == ".png" else image.width
        return {"data": data_uri(path), "width": width}


def table(rows: list[dict]) -> dict:
    """Heads and cells of a table; shares as percent, the two ends of an interval in one column."""
    keys = [key for key in dict.fromkeys(key for row in rows for key in row) if key not in INTERVALS.values()]
    heads = ["95 % interval" if key == "low" else HEADS.get(key, key.replace("_", " ")) for key in keys]
    names = short_names(str(row[key]) for row in rows for key in SPECS if row.get(key) is not None)
    return {"heads": heads, "rows": [[cell(key, row, names) for key in keys] for row in rows]}


def cell(key: str, row: dict, names: Mapping[str, str]) -> str:
    """A value as a table shows it; `names`: of detectors, by their specs."""
    value = row.get(key)
    if value is None:
        return "–"
    if key in INTERVALS:
        return interval([value, row[INTERVALS[key]]])
    if key in SPECS:
        return names[str(value)]
    if isinstance(value, (str, bool)):
        return str(value)
    if isinstance(value, int):
        return f"{value:,}"
    if key in FORMATS:
        return FORMATS[key].format(value)
    if key == "gap":
        return f"{100 * value:+.1f}".replace("-", "\N{MINUS SIGN}")
    return f"{100 * value:.1f} %" if key == "area_share" else percent(value)
