"""Dress people in photographs in anything and judge them, for `cloak wear` and the card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cloak_core.core.cameras import Number
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation.controls import CLOTHING
from cloak_core.core.evaluation.measure import OnProgress, kept_frozen, measure
from cloak_core.core.evaluation.results import NOBODY, Results
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.evaluation.statistics import false_alarms, finite, side_record, success_record
from cloak_core.files.errors import InputError
from cloak_core.files.tables import as_cell
from cloak_core.files.writing import new_folder, require_new, write_json, write_text
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.photographs.fits import fit_people, those_who_fit
from cloak_core.sources.photographs.fitting import Fit
from cloak_core.sources.photographs.people import People
from cloak_core.studies.wearing.clothes import CONTROLS, Clothes, read_clothes
from cloak_core.studies.wearing.pages import Album
from cloak_core.studies.wearing.renderer import PeopleRenderer


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
    CLOTHES.jpg, sheet.jpg, scores.csv (a row for each detector, clothes and person) and wear.json; nothing is left of
    it where this fails.
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
        return _judged(clothes, people, detectors, backgrounds, settings, on_progress, None) | dict(more or {})
    require_new(out)
    with new_folder(out) as folder:
        result = _judged(clothes, people, detectors, backgrounds, settings, on_progress, folder)
        result |= dict(more or {})
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
    """Dress every fitted person in everything and ask every detector; also about backgrounds without people."""
    fits, points = fit_people(people), {spec: detector.operating_point for spec, detector in detectors.items()}
    people = those_who_fit(people, fits)
    renderer = PeopleRenderer(fits, clothes, backgrounds, settings, next(iter(detectors.values())).device)
    album = None if folder is None else Album(folder, renderer.body_names, list(points.values()), list(points))
    told = {"batch": settings.batch, "on_progress": on_progress, "on_images": album and album.add_all}
    bare = np.arange(min(settings.bare, len(backgrounds)))
    with kept_frozen(detectors):
        results = measure(renderer, detectors, tuple(renderer.clothes), bare, **told)
    if album is not None:
        album.write()
        write_text(folder / "scores.csv", _table(results, people))
    return {
        "detectors": {
            spec: {name: _record(results, spec, name, settings.threshold) for name in results.controls}
            for spec in detectors
        },
        "people": len(people),
        "photographs": len(people.photographs),
        "left_out": people.left_out,
        "false_alarms": {spec: finite(false_alarms(results, spec, settings.threshold)) for spec in detectors},
        "operating_points": points,
        "fit": mean_quality(fits),
    }


def _record(results: Results, spec: str, name: str, threshold: Number) -> dict:
    """Count S of contract C8 with `seen_from`: the people seen from the front, from the side and from behind."""
    rows = results.rows(spec, name)
    return success_record(results, rows, threshold) | side_record(rows, threshold)


def mean_quality(fits: Sequence[Fit]) -> dict[str, float]:
    """Average the quality of people's fits."""
    qualities = [fit.quality for fit in fits]
    return {key: round(float(np.mean([one[key] for one in qualities])), 4) for key in sorted(qualities[0])}


def _table(results: Results, people: People) -> str:
    """List every detector's score of every person in everything, as CSV."""
    shown = results.images[(results.images["control"] != NOBODY).to_numpy()].rename(columns={"control": "clothes"})
    shown = shown.assign(person=[people.people[pose].number for pose in shown["pose"]])
    columns = ["detector", "clothes", "photograph", "person", "seen_from", "score", "other", "other_name"]
    return shown[columns].map(as_cell).to_csv(index=False, float_format="%.4f", lineterminator="\n")
