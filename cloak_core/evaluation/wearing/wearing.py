"""`cloak wear` as one call: dress people, judge them, write pictures and a table."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.measure import OnProgress
from cloak_core.evaluation.results import NOBODY, Results
from cloak_core.evaluation.statistics import false_alarms, finite, operating_point, share, success_record
from cloak_core.evaluation.wearing.clothes import CONTROLS, Clothes, read_clothes
from cloak_core.evaluation.wearing.judging import Shot, judge_people
from cloak_core.evaluation.wearing.pictures import Album
from cloak_core.evaluation.wearing.rating import Rating
from cloak_core.evaluation.wearing.settings import WearSettings
from cloak_core.files.errors import InputError
from cloak_core.files.writing import new_folder, write_json, write_text
from cloak_core.render.photographs.fits import fit_people
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.cameras import Number
from cloak_core.scene.photographs.people import People


def wear_and_judge(
    colors: Sequence[str | Clothes],
    people: People,
    detectors: Mapping[str, Detector],
    backgrounds: Backgrounds,
    out: Path | None = None,
    settings: WearSettings | None = None,
    on_progress: OnProgress | None = None,
    more: Mapping[str, object] | None = None,
) -> dict:
    """Dress people in each of `colors` and in the controls, and judge them.

    backgrounds: without people, for false alarms. out: a new folder for pictures/PERSON/before.jpg and after
    CLOTHES.jpg, sheet.jpg, scores.csv (a row for each detector, clothes and person), wear.json and, where the settings
    ask for pairs, rate.html and rate-key.csv; nothing is left of it where this fails.
    more: what the result says besides.
    Returns what `cloak wear --json` prints (contract C8). `InputError`: names COLORS, file or option.
    """
    settings = settings or WearSettings()
    clothes = [read_clothes(color) if isinstance(color, str) else color for color in colors]
    names = [one.name for one in clothes]
    for name in names:
        if names.count(name) > 1 or name in (CLOTHING, *CONTROLS):
            raise InputError(f"{name}: given twice, or called as a control is")
    if not detectors:
        raise InputError("--detector: none given")
    if out is None:
        if settings.pairs:
            raise InputError("--pairs: needs --out, the folder that the page is written to")
        return _judged(clothes, people, detectors, backgrounds, settings, on_progress, None) | (more or {})
    if out.exists():
        raise InputError(f"{out}: exists already")
    with new_folder(out) as folder:
        result = _judged(clothes, people, detectors, backgrounds, settings, on_progress, folder) | (more or {})
        write_json(folder / "wear.json", result)
    return result | {"out": str(out)}


def _judged(
    clothes: Sequence[Clothes],
    people: People,
    detectors: Mapping[str, Detector],
    backgrounds: Backgrounds,
    settings: WearSettings,
    on_progress: OnProgress | None,
    folder: Path | None,
) -> dict:
    fits = fit_people(people)
    names, pages = [person.name for person in people.people], []
    if folder is not None:
        pages = [Album(folder, names)]
        pages += (
            [Rating(folder, names, [*(one.name for one in clothes), CLOTHING], settings.pairs)]
            if settings.pairs
            else []
        )

    def on_shot(shot: Shot) -> None:
        for page in pages:
            page.add(shot)

    told = on_shot if pages else None
    results = judge_people(fits, clothes, detectors, backgrounds, settings, on_progress, told)
    for page in pages:
        page.write()
    if folder is not None:
        write_text(folder / "scores.csv", _table(results, people))
    alarms = {spec: finite(false_alarms(results, spec, settings.threshold)) for spec in detectors}
    return {
        "detectors": {
            spec: {name: _record(results, spec, name, settings.threshold) for name in results.controls}
            for spec in detectors
        },
        "people": len(people),
        "photographs": len(people.photographs),
        "left_out": people.left_out,
        "false_alarms": alarms,
        "operating_points": {spec: detector.operating_point for spec, detector in detectors.items()},
        "fit": {key: round(float(np.mean([fit.quality[key] for fit in fits])), 4) for key in fits[0].quality},
    }


def _record(results: Results, spec: str, name: str, threshold: Number) -> dict:
    """S of contract C8, and the shares of people seen from the front, from the side and from behind."""
    rows = results.rows(spec, name)
    sides = {side: rows[(rows["seen_from"] == side).to_numpy()] for side in ("front", "side", "back")}
    point = operating_point(rows)
    told = {
        side: {"n": len(seen), "success": finite(share(seen, threshold)), "success_own": finite(share(seen, point))}
        for side, seen in sides.items()
        if len(seen)
    }
    return success_record(results, rows, threshold) | {"seen_from": told}


def _table(results: Results, people: People) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("detector", "clothes", "photograph", "person", "seen_from", "score", "other", "other_name"))
    shown = results.images[(results.images["control"] != NOBODY).to_numpy()]
    for row in shown.itertuples():
        other = ("", "") if np.isnan(row.other) else (f"{row.other:.4f}", row.other_name)
        number = people.people[row.pose].number
        rows.writerow((row.detector, row.control, row.photograph, number, row.seen_from, f"{row.score:.4f}", *other))
    return text.getvalue()
