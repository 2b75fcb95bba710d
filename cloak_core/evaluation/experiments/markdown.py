"""The experiments' tables and figures as Markdown, for documentation: written by the command, never by hand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from cloak_core.evaluation.controls import LOGO
from cloak_core.evaluation.experiments.index_page import table
from cloak_core.evaluation.experiments.registry import finished
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import write_text
from cloak_core.scene.pictures import read_picture, save_picture

ROWS, SHOWN = 120, 30
"""Rows of the table of results, a defence's for every detector among them, and of other tables; the rest stay in
numbers.csv and thresholds.csv."""
LEFT_OUT = ("clean_detection", "false_alarms", "seeds", "worst_seed", "best_seed", "success_iou", "seconds")
"""Columns that a narrow table can spare where they say nothing new: all are in numbers.csv."""
COLORS = 128
"""Of a published figure: plots have few, and the files stay small."""


def publish(out: Path, folder: Path) -> Path:
    """Write FOLDER/tables.md, one section for every finished experiment of OUT, with plots beside it; its path."""
    records = finished(out)
    if not records:
        raise InputError(f"{out}: holds no finished experiment")
    folder.mkdir(parents=True, exist_ok=True)
    parts = ["# Experiments\n\nWritten by `cloak reproduce --publish`; [what it means](../results.md).\n"]
    for name, record in records.items():
        figures = [_copy(out / name / file, folder / f"{name}-{file}") for file in record["figures"] if _is_shown(file)]
        config = read_json(out / name / "config.json")
        command = str(config.get("command", "")).replace(str(out), "OUT").replace(str(folder), "DOCS")
        command = without_folders(command)
        parts.append(_section(name, record, config | {"command": command}, figures))
    path = folder / "tables.md"
    write_text(path, "\n".join(parts))
    return path


def _is_shown(file: str) -> bool:
    """Plots, but no pictures: whether the photographs in those may be published only their owner knows."""
    return file.endswith(".png") and not file.startswith("pictures")


def _copy(source: Path, target: Path) -> str:
    image = Image.fromarray(read_picture(source)).quantize(COLORS, dither=Image.Dither.NONE)
    save_picture(target, image, optimize=True)
    return target.name


def _section(name: str, record: dict, config: dict, figures: Sequence[str]) -> str:
    lines = [f"## {name}: {record['title']}", ""]
    for paragraph in record["words"]:
        lines += [paragraph, ""]
    lines += [f"![{record['title']}]({file})\n" for file in figures]
    rows = record["rows"][:ROWS]
    lines += grid([{k: v for k, v in row.items() if k not in LEFT_OUT} for row in rows])
    if len(record["rows"]) > ROWS:
        lines.append(f"And {len(record['rows']) - ROWS} more rows in numbers.csv.\n")
    spread = [row for row in rows if row.get("seeds", 1) > 1]
    if spread:
        lines += ["Spread over seeds:", "", *grid([_only(row, "seeds", "worst_seed", "best_seed") for row in spread])]
    curves = [row for row in record.get("thresholds", []) if row["control"] == LOGO]
    if curves:
        lines += ["Trained colours at other thresholds (controls in thresholds.csv):", "", *grid(curves[:SHOWN])]
    if record["paper"]:
        lines += ["The paper's values:", "", *grid(record["paper"])]
    counts = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in record["counts"].items())
    versions = ", ".join(f"{key} {config[key]}" for key in ("cloak", "torch", "threads") if key in config)
    lines += [f"`{config['command']}`\n"] if config["command"] else []
    lines.append(f"{counts}; {versions}.\n")
    return "\n".join(lines)


def _only(row: dict, *kept: str) -> dict:
    """A row's own label (what stands before its success) and some columns."""
    label = list(row)[: list(row).index("success")]
    return {key: row[key] for key in (*label, *kept)}


def grid(rows: list[dict]) -> list[str]:
    """A Markdown table, and an empty line after it."""
    shown = table(rows)
    lines = [shown["heads"], ["---"] * len(shown["heads"]), *shown["rows"]]
    return ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |" for cells in lines] + [""]
