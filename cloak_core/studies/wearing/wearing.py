"""Dress people in photographs and judge them, for `cloak wear` and `cloak evaluate --people`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from torch import Tensor

from cloak_core.core.cameras import Number
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation.controls import CLOTHING, LOGO
from cloak_core.core.evaluation.measure import OnImages, OnProgress, measure
from cloak_core.core.evaluation.results import NOBODY, Results
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.evaluation.statistics import false_alarms, finite, operating_point, share, success_record
from cloak_core.files.errors import InputError
from cloak_core.files.writing import new_folder, write_json, write_text
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.photographs.fits import fit_people
from cloak_core.sources.photographs.people import People
from cloak_core.studies.report.pictures import to_pil
from cloak_core.studies.wearing.clothes import CONTROLS, Clothes, read_clothes
from cloak_core.studies.wearing.pages import Album, Rating
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


def evaluate_on_people(
    run: Path,
    config: dict,
    people: People,
    detectors: Mapping[str, Detector],
    backgrounds: Backgrounds,
    out: Path,
    settings: WearSettings | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Judge a run's colours on people in photographs, beside controls, into the new folder `out`.

    Returns what `cloak evaluate RUN --people --json` prints: contract C6's object with S for "logo" and the controls;
    "unseen": whether training saw none of the photographs; "white_box": which detectors it was trained against.
    """
    if out.exists():
        raise InputError(f"{out}: exists already (--out names another folder)")
    clothes = replace(read_clothes(str(run)), name=LOGO)
    trained = (config.get("people") or {}).get("photographs", [])
    known = {record["spec"] for record in config["detectors"]}
    more = {
        "unseen": {"photographs": not np.isin(people.photographs, trained).any()},
        "white_box": {spec: spec in known for spec in detectors},
    }
    return wear_and_judge([clothes], people, detectors, backgrounds, out, settings, on_progress, more)


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
    renderer = PeopleRenderer(fits, clothes, backgrounds, settings, next(iter(detectors.values())).device)
    pages: list[Album | Rating] = []
    if folder is not None:
        pages.append(Album(folder, renderer.body_names, list(points.values())))
    if settings.pairs:
        compared = [*(one.name for one in clothes), CLOTHING]
        pages.append(Rating(folder, renderer.body_names, compared, settings.pairs))
    told = {"on_progress": on_progress, "on_images": _shown_on(pages) if pages else None}
    bare = np.arange(min(settings.bare, len(backgrounds)))
    results = measure(renderer, detectors, tuple(renderer.clothes), bare, batch=settings.batch, **told)
    for page in pages:
        page.write()
    if folder is not None:
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
        "fit": {key: round(float(np.mean([fit.quality[key] for fit in fits])), 4) for key in sorted(fits[0].quality)},
    }


def _shown_on(pages: Sequence[Album | Rating]) -> OnImages:
    """Hand every judged image with its boxes to these pages."""

    def show(control: str, people: np.ndarray, images: Tensor, boxes: pd.DataFrame) -> None:
        for person, image in zip(people.tolist(), images, strict=True):
            mine = boxes[(boxes["image"] == person).to_numpy()]
            for page in pages:
                page.add(control, person, to_pil(image), mine)

    return show


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
    """List every detector's score of every person in everything, as CSV."""
    shown = results.images[(results.images["control"] != NOBODY).to_numpy()].rename(columns={"control": "clothes"})
    shown = shown.assign(person=[people.people[pose].number for pose in shown["pose"]])
    columns = ["detector", "clothes", "photograph", "person", "seen_from", "score", "other", "other_name"]
    return shown[columns].to_csv(index=False, float_format="%.4f", lineterminator="\n")
