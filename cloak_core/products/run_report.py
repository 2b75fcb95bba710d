"""Write a run's report from what its folder holds: its record, the curves of its training, and its evaluation."""

from __future__ import annotations

import json
from itertools import groupby
from operator import itemgetter
from pathlib import Path

from cloak_core.core.evaluation.results import NOBODY
from cloak_core.core.evaluation.statistics import hidden
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.studies.evaluate import FOLDER, StoredEvaluation, read_evaluation
from cloak_core.studies.report import plots, words
from cloak_core.studies.report.page import MAX_PICTURE, data_uri, page_style, shot, svg, write_page
from cloak_core.studies.trained_run import read_history

BLENDER = "blender.png"
"""What a training through Blender leaves in the run folder: the cloaked body as Blender renders it."""
TURNTABLE = "turntable.gif"
"""What `cloak film RUN --camera orbit --out RUN/turntable.gif` leaves there; it stands for the evaluation's own."""


def make_report(run: Path) -> Path:
    """Write RUN/report.html from what the run folder holds and return its path.

    A run without an evaluation gets a report that says so. InputError names a folder that is no run, or a damaged file.
    """
    run = Path(run)
    if not (run / "config.json").exists():
        raise InputError(f"{run}: not a run folder (no config.json in it)")
    config = read_json(run / "config.json")
    history = read_history(run)
    stored = read_evaluation(run / FOLDER) if (run / FOLDER).exists() else None
    with page_style():
        page = {
            "name": run.resolve().name,
            "config": config,
            "config_text": json.dumps(config, indent=2),
            "history": history,
            "training": svg(plots.training_curves(history)) if history.losses or history.success else None,
            "previews": _previews(run),
            "blender": data_uri(run / BLENDER) if (run / BLENDER).exists() else None,
            "turntable": _turntable(run, stored),
            "evaluation": _evaluation(stored) if stored else None,
        }
    return write_page(run / "report.html", "report.html", page)


def _previews(run: Path) -> list[str]:
    """Read the first and the last preview, as data."""
    files = sorted((run / "previews").glob("*.png"))
    return [data_uri(file) for file in dict.fromkeys(files[:1] + files[-1:]) if file.stat().st_size <= MAX_PICTURE]


def _turntable(run: Path, stored: StoredEvaluation | None) -> str | None:
    """Read the run's film from all around, or the evaluation's, as data; evaluations of few images have none."""
    if (run / TURNTABLE).exists():
        return data_uri(run / TURNTABLE)
    if stored is None or "turntable" not in stored.pictures:
        return None
    return data_uri(stored.folder / "pictures" / Path(stored.pictures["turntable"]).name)


def _evaluation(stored: StoredEvaluation) -> dict:
    summary, pictures, folder = stored.summary, stored.pictures, stored.folder / "pictures"
    specs = list(summary["detectors"])
    shown = [_pair(folder, specs, pair) for pair in pictures["gallery"]]
    gallery = [(body, list(pairs)) for body, pairs in groupby(shown, key=itemgetter("body"))]
    strip = pictures["controls"]
    images = {control: shot(folder, specs, picture) for control, picture in strip["images"].items()}
    return {
        "summary": summary,
        "threshold": summary["settings"]["threshold"],
        "detectors": [_detector(stored, d, spec) for d, spec in enumerate(specs)],
        "controls": list(stored.results.controls),
        "gallery": gallery,
        "columns": max([3, *(len(pairs) for _, pairs in gallery)]),  # fewer would be larger than they were rendered
        "strip": _label(strip) | {"images": images},
        "flat": {side: data_uri(folder / Path(name).name) for side, name in pictures["flat"].items()},
        "size": summary["settings"]["size"],
    }


def _detector(stored: StoredEvaluation, d: int, spec: str) -> dict:
    results, summary, folder = stored.results, stored.summary, stored.folder / "pictures"
    rates, threshold = summary["detectors"][spec], summary["settings"]["threshold"]
    logo = results.rows(spec, results.controls[0])
    figures = plots.evaluation_figures(results, spec, threshold)
    worst = stored.pictures.get("worst", {}).get(spec, [])
    return {
        "index": d,
        "spec": spec,
        "own": summary.get("operating_points", {}).get(spec),
        "name": words.short_name(spec),
        "rows": [(c, rates[c], rates["average_precision"][c]) for c in results.controls],
        "false_alarms": summary["false_alarms"][spec],
        "bare": len(results.rows(spec, NOBODY)),
        "figures": {title: svg(figure) for title, figure in figures.items()},
        "failures": [_pair(folder, [spec], pair) for pair in stored.pictures["failures"].get(spec, [])],
        "worst": [_pair(folder, [spec], pair) | {"success": pair["success"]} for pair in worst],
        "bodies": logo["pose"].nunique(),
        "failed": int((~hidden(logo, threshold)).sum()),
        "hash": summary["inputs"]["detector_hashes"][spec],
    }


def _pair(folder: Path, specs: list[str], pair: dict) -> dict:
    return _label(pair) | {control: shot(folder, specs, pair[control]) for control in ("clothing", "logo")}


def _label(told: dict) -> dict:
    return {key: told.get(key) for key in ("body", "angle", "distance", "background")}
