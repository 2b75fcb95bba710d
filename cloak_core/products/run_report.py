"""Write a run's report from what its folder holds: its record, the curves of its training, and its evaluation."""

from __future__ import annotations

import json
from itertools import groupby
from operator import itemgetter
from pathlib import Path

from cloak_core.core.evaluation.results import NOBODY
from cloak_core.core.evaluation.statistics import undetected
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.studies.report import plots, words
from cloak_core.studies.report.page import MAX_PICTURE, data_uri, page_style, shot, svg, write_page
from cloak_core.studies.report.stored import (
    FOLDER,
    PEOPLE_FOLDER,
    StoredEvaluation,
    is_earlier_on_people,
    read_evaluation,
)
from cloak_core.studies.trained_run import read_history

BLENDER = "blender.png"
"""What a training through Blender leaves in the run folder: the cloaked body as Blender renders it."""
TURNTABLE = "turntable.gif"
"""What `cloak film RUN --camera orbit --out RUN/turntable.gif` leaves there; it stands for the evaluation's own."""


def make_report(run: Path) -> Path:
    """Write RUN/report.html from what the run folder holds and return its path.

    An evaluation on people in photographs comes before the one on rendered bodies. A run without any gets a report that
    says so. InputError names a folder that is no run, or a damaged file.
    """
    run = Path(run)
    if not (run / "config.json").exists():
        raise InputError(f"{run}: not a run folder (no config.json in it)")
    config = read_json(run / "config.json")
    history = read_history(run)
    stored = read_evaluation(run / FOLDER) if (run / FOLDER).exists() else None
    earlier = is_earlier_on_people(run / PEOPLE_FOLDER)
    people = read_evaluation(run / PEOPLE_FOLDER) if (run / PEOPLE_FOLDER).exists() and not earlier else None
    files = sorted((run / "previews").glob("*.png"))
    previews = dict.fromkeys(files[:1] + files[-1:])
    with page_style():
        page = {
            "name": run.resolve().name,
            "config": config,
            "config_text": json.dumps(config, indent=2),
            "history": history,
            "training": svg(plots.training_curves(history)) if history.losses or history.success else None,
            "previews": [data_uri(file) for file in previews if file.stat().st_size <= MAX_PICTURE],
            "blender": data_uri(run / BLENDER) if (run / BLENDER).exists() else None,
            "turntable": _turntable(run, stored),
            "evaluation": _evaluation(stored) if stored else None,
            "photographs": _photographs(people) if people else None,
            "earlier_photographs": earlier,
        }
    return write_page(run / "report.html", "report.html", page)


def _turntable(run: Path, stored: StoredEvaluation | None) -> str | None:
    """Read the run's film from all around, or the evaluation's, as data; evaluations of few images have none."""
    if (run / TURNTABLE).exists():
        return data_uri(run / TURNTABLE)
    if stored is None or "turntable" not in stored.pictures:
        return None
    return data_uri(stored.folder / "pictures" / Path(stored.pictures["turntable"]).name)


def _judged(stored: StoredEvaluation, specs: list[str]) -> dict:
    """Prepare what is shown of any evaluation: where boxes are drawn, pairs of pictures, one image in every pattern."""
    folder, points = stored.folder / "pictures", _thresholds(stored)
    strip = stored.pictures["controls"]
    named = (f"{points[spec]:g} ({words.short_name(spec)})" for spec in specs)
    return {
        "threshold": stored.summary["settings"]["threshold"],
        "size": stored.summary["settings"]["size"],
        "shown_at": ", ".join(named) if len(set(points.values())) > 1 else f"{points[specs[0]]:g}",
        "gallery": [_pair(folder, specs, pair) for pair in stored.pictures["gallery"]],
        "strip": {control: shot(folder, specs, picture) for control, picture in strip["images"].items()},
    }


def _evaluation(stored: StoredEvaluation) -> dict:
    """Prepare what is shown of renders."""
    folder = stored.folder / "pictures"
    specs = list(stored.summary["detectors"])
    shown = _judged(stored, specs)
    gallery = [(body, list(pairs)) for body, pairs in groupby(shown["gallery"], key=itemgetter("body"))]
    return shown | {
        "summary": stored.summary,
        "detectors": [_on_bodies(stored, spec) for spec in specs],
        "gallery": gallery,
        "columns": max([3, *(len(pairs) for _, pairs in gallery)]),  # fewer would be larger than they were rendered
        "strip": _label(stored.pictures["controls"]) | {"images": shown["strip"]},
        "flat": {side: data_uri(folder / Path(name).name) for side, name in stored.pictures["flat"].items()},
    }


def _photographs(stored: StoredEvaluation) -> dict:
    """Prepare what is shown of people in photographs.

    Detectors that the colours were never trained against come first.
    """
    summary = stored.summary
    specs = sorted(summary["detectors"], key=lambda spec: summary["white_box"].get(spec) is not False)
    rates = {spec: summary["detectors"][spec] for spec in specs}
    rows = {spec: [(control, rates[spec][control]) for control in stored.results.controls] for spec in specs}
    return _judged(stored, specs) | {
        "summary": summary | {"detectors": rates},
        "unseen": summary["unseen"].get("photographs"),
        "detectors": [
            _detector(stored, spec) | {"white_box": summary["white_box"].get(spec), "rows": rows[spec]}
            for spec in specs
        ],
    }


def _on_bodies(stored: StoredEvaluation, spec: str) -> dict:
    """Prepare what is shown of a detector that judged renders."""
    results, rates = stored.results, stored.summary["detectors"][spec]
    figures = plots.evaluation_figures(results, spec, stored.summary["settings"]["threshold"])
    worst = stored.pictures.get("worst", {}).get(spec, [])
    return _detector(stored, spec) | {
        "rows": [(c, rates[c], rates["average_precision"][c]) for c in results.controls],
        "figures": {title: svg(figure) for title, figure in figures.items()},
        "worst": [_pair(stored.folder / "pictures", [spec], pair) | {"success": pair["success"]} for pair in worst],
        "bodies": results.rows(spec, results.controls[0])["pose"].nunique(),
    }


def _detector(stored: StoredEvaluation, spec: str) -> dict:
    """Prepare what is shown of any detector that judged."""
    results, summary = stored.results, stored.summary
    logo, at = results.rows(spec, results.controls[0]), _thresholds(stored)[spec]
    failures = stored.pictures["failures"].get(spec, [])
    return {
        "spec": spec,
        "own": summary.get("operating_points", {}).get(spec),
        "name": words.short_name(spec),
        "false_alarms": summary["false_alarms"][spec],
        "bare": len(results.rows(spec, NOBODY)),
        "failures": [_pair(stored.folder / "pictures", [spec], pair) for pair in failures],
        "at": at,
        "failed": int((~undetected(logo, at)).sum()),
        "hash": summary["inputs"]["detector_hashes"][spec],
    }


def _thresholds(stored: StoredEvaluation) -> dict[str, float]:
    """Give what the pictures are shown at: the detectors' own; in earlier evaluations the one that was asked for."""
    asked = dict.fromkeys(stored.summary["detectors"], stored.summary["settings"]["threshold"])
    return stored.pictures.get("thresholds", asked)


def _pair(folder: Path, specs: list[str], pair: dict) -> dict:
    return _label(pair) | {control: shot(folder, specs, pair[control]) for control in ("clothing", "logo")}


def _label(trial: dict) -> dict:
    return {key: trial.get(key) for key in ("body", "angle", "distance", "background")}
