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
from cloak_core.studies.report import plots
from cloak_core.studies.report.page import MAX_PICTURE, data_uri, figures, inside, write_page
from cloak_core.studies.report.stored import (
    FOLDER,
    PEOPLE_FOLDER,
    StoredEvaluation,
    is_earlier_on_people,
    read_evaluation,
)
from cloak_core.studies.report.words import short_name
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
    values = {
        "name": run.resolve().name,
        "config": config,
        "config_text": json.dumps(config, indent=2),
        "history": history,
        "training": figures(lambda: {"curves": plots.training_curves(history)}).get("curves"),
        "previews": [data_uri(file) for file in previews if file.stat().st_size <= MAX_PICTURE],
        "blender": data_uri(run / BLENDER) if (run / BLENDER).exists() else None,
        "turntable": _turntable(run, stored),
        "evaluation": _shown(stored) if stored else None,
        "photographs": _shown(people) if people else None,
        "earlier_photographs": earlier,
    }
    return write_page(run / "report.html", "report.html", values)


def _turntable(run: Path, stored: StoredEvaluation | None) -> str | None:
    """Read the run's film from all around, or the evaluation's, as data; evaluations of few images have none."""
    if (run / TURNTABLE).exists():
        return data_uri(run / TURNTABLE)
    if stored is None or "turntable" not in stored.pictures:
        return None
    return inside(stored.pictures["turntable"], stored.folder / "pictures")


def _shown(stored: StoredEvaluation) -> dict:
    """Gather what the templates show of an evaluation: what its files say, and of each detector what its rows say.

    Of people in photographs, detectors that the colours were never trained against come first.
    """
    summary, pictures, results = stored.summary, stored.pictures, stored.results
    threshold, rates = summary["settings"]["threshold"], summary["detectors"]
    on_people = stored.folder.name == PEOPLE_FOLDER
    specs = sorted(rates, key=lambda spec: on_people and summary["white_box"].get(spec) is not False)
    # What the pictures are shown at: the detectors' own thresholds; in earlier evaluations the one that was asked for.
    at = pictures.get("thresholds", dict.fromkeys(specs, threshold))
    detectors = []
    for spec in specs:
        logo = results.rows(spec, results.controls[0])
        detectors.append(
            {
                "spec": spec,
                "name": short_name(spec),
                "at": at[spec],
                "failed": int((~undetected(logo, at[spec])).sum()),
                "bare": len(results.rows(spec, NOBODY)),
                "bodies": logo["pose"].nunique(),
                "figures": {} if on_people else figures(plots.evaluation_figures, results, spec, threshold),
            }
        )
    named = ", ".join(f"{detector['at']:g} ({detector['name']})" for detector in detectors)
    return {
        "summary": summary | {"detectors": {spec: rates[spec] for spec in specs}},
        "pictures": pictures,
        "gallery": [(body, list(pairs)) for body, pairs in groupby(pictures["gallery"], key=itemgetter("body"))],
        "folder": stored.folder / "pictures",
        "specs": specs,
        "controls": results.controls,
        "detectors": detectors,
        "shown_at": named if len(set(at.values())) > 1 else f"{at[specs[0]]:g}",
    }
