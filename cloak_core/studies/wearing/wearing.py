"""Dress people in photographs in anything and judge them, for `cloak wear` and the card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluate import Patterns, measure_frozen
from cloak_core.core.evaluation.controls import NAMES, RESAMPLED, STANDARD
from cloak_core.core.evaluation.measure import OnProgress, check_asked
from cloak_core.core.evaluation.results import NOBODY, Results
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.evaluation.statistics import false_alarms, finite, side_record, success_record
from cloak_core.core.logo import Cover, select_region
from cloak_core.files.errors import InputError
from cloak_core.files.tables import as_cell
from cloak_core.files.writing import new_folder, require_new, write_json, write_text
from cloak_core.patterns.controls import OwnClothing, controls
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import People
from cloak_core.studies.opening import clothes_cover, open_pattern
from cloak_core.studies.wearing.pages import Album

CONTROLS = (*STANDARD, RESAMPLED)
"""What people wear beside what is judged, on shirt and trousers or what --logo says."""
GREY_HEADWEAR = "grey headwear"
"""A control where heads are covered: own clothing with as much of the head in grey, which alone may hide somebody."""


def wear_and_judge(
    colors: Sequence[str],
    people: Crowd,
    detectors: dict[str, Detector],
    backgrounds: Backgrounds,
    out: Path | None = None,
    settings: WearSettings | None = None,
    on_progress: OnProgress | None = None,
    more: Mapping[str, object] | None = None,
    logo: str | None = None,
) -> dict:
    """Dress people in each of `colors` and in the controls, and judge them.

    backgrounds: without people, for false alarms. out: a new folder for pictures/PERSON/before.jpg and after
    CLOTHES.jpg, sheet.jpg, scores.csv (a row for each detector, clothes and person) and wear.json; nothing is left of
    it where this fails.
    more: what the result says besides. logo: what cloths, pictures and controls cover (`clothes_cover`).
    Returns what `cloak wear --json` prints (contract C8). `InputError`: names COLORS, file or option.
    """
    settings = settings or WearSettings()
    check_asked(detectors)
    cover = clothes_cover(logo)
    patterns = {name: pattern.on(cover) if logo else pattern for pattern, _, name in map(open_pattern, colors)}
    for name in patterns:
        if len(patterns) < len(colors) or name in NAMES:
            raise InputError(f"{name}: given twice, or called as a control is")
    patterns |= controls(CONTROLS, OwnClothing(cover), settings.seed)
    head = np.intersect1d(cover.face_ids, select_region(sample_bodies(), "head"))
    if len(head):
        headwear = OwnClothing(Cover(head, cover.topology, name="headwear"))
        patterns[GREY_HEADWEAR] = controls(("grey",), headwear)["grey"]
    more = {"cover": cover.name} | dict(more or {})
    if out is None:
        return _judged(patterns, people, detectors, backgrounds, settings, on_progress, None) | more
    require_new(out)
    with new_folder(out) as folder:
        result = _judged(patterns, people, detectors, backgrounds, settings, on_progress, folder) | more
        write_json(folder / "wear.json", result)
    return result | {"out": str(out)}


def _judged(
    patterns: Patterns,
    people: Crowd,
    detectors: dict[str, Detector],
    backgrounds: Backgrounds,
    settings: WearSettings,
    on_progress: OnProgress | None,
    folder: Path | None,
) -> dict:
    """Dress every fitted person in everything and ask every detector; also about backgrounds without people."""
    wearers = people.wearers(patterns.values())
    points = {spec: detector.operating_point for spec, detector in detectors.items()}
    images = wearers.images(backgrounds, settings, next(iter(detectors.values())).device)
    album = None if folder is None else Album(folder, images.body_names, points)
    bare = np.arange(min(settings.bare, len(backgrounds)))
    on_images = None if album is None else album.add_all
    results, _ = measure_frozen(images, patterns, detectors, settings, on_progress, on_images, bare)
    if album is not None:
        album.write()
        write_text(folder / "scores.csv", _table(results, wearers.people))

    def record(spec: str, name: str) -> dict:
        """Count S of contract C8 with `seen_from`: the people seen from the front, from the side and from behind."""
        rows = results.rows(spec, name)
        counted = success_record(results, rows, settings.threshold) | side_record(rows, settings.threshold)
        return counted | {"cover": patterns[name].cover.name}

    return {
        "detectors": {spec: {name: record(spec, name) for name in results.controls} for spec in detectors},
        "people": len(wearers),
        "photographs": len(wearers.people.photographs),
        "left_out": wearers.people.left_out,
        "false_alarms": {spec: finite(false_alarms(results, spec, settings.threshold)) for spec in detectors},
        "operating_points": points,
        "fit": wearers.quality(),
    }


def _table(results: Results, people: People) -> str:
    """List every detector's score of every person in everything, as CSV."""
    shown = results.images[(results.images["control"] != NOBODY).to_numpy()].rename(columns={"control": "clothes"})
    shown = shown.assign(person=[people.people[pose].number for pose in shown["pose"]])
    columns = ["detector", "clothes", "photograph", "person", "seen_from", "score", "other", "other_name"]
    return shown[columns].map(as_cell).to_csv(index=False, float_format="%.4f", lineterminator="\n")
