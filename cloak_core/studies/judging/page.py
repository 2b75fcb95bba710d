"""The report on photographs: what the template judge.html shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from cloak_core.core.evaluation.statistics import hidden
from cloak_core.studies.judging.listing import NOBODY, WITH, WITHOUT
from cloak_core.studies.report import page, plots
from cloak_core.studies.report.words import short_name
from cloak_core.studies.statistics_photographs import find_partners

PAIRS, WORST = 8, 6
LABELS = {WITH: "with the cloak", WITHOUT: "without"}
GROUPS = {"by_person": "person", "by_scene": "scene", "by_distance": "distance (m)"}


@dataclass(frozen=True, eq=False)
class Picture:
    """One photograph, or one frame of a video, as the detectors saw it."""

    file: str
    frame: int
    """0 for photographs."""
    width: int
    height: int
    scale: float
    """Of the file's pixels."""
    boxes: dict[str, list[list[float]]]
    """By detector: x1, y1, x2, y2, score above the lower of both thresholds, best first, pixels as shown."""
    thumbnail: str
    """A data: address; empty where there are too many."""


def write_report(path: Path, name: str, summary: dict, rows: pd.DataFrame, pictures: Sequence[Picture]) -> Path:
    """Write the report of `judge` and return its path; rows, pictures: what `look` returned."""
    by_detector = {
        str(spec): mine.reset_index(drop=True) for spec, mine in rows.groupby("detector", sort=False, observed=True)
    }
    subjects = next(iter(by_detector.values()))
    scores = [(short_name(spec), mine["score"].to_numpy()) for spec, mine in by_detector.items()]
    shot = lambda i: _shot(subjects.loc[i], pictures, [(name, float(score[i])) for name, score in scores])
    with page.page_style():
        detectors = [_detector(summary, spec, mine, shot) for spec, mine in by_detector.items()]
    values = {
        "name": name,
        "summary": summary,
        "detectors": detectors,
        "pairs": [[shot(i) for i in pair] for pair in shown_pairs(subjects)],
        "settings": [(key.replace("_", " "), f"{value:g}") for key, value in summary["settings"].items()],
    }
    return page.write_page(path, "judge.html", values)


def shown_pairs(subjects: pd.DataFrame) -> list[tuple[int, int]]:
    """Choose (without, with): the first pair of each person and place, at most eight, evenly spaced, not by score."""
    partners, first = find_partners(subjects), {}
    for i, (garment, *key) in enumerate(subjects[["garment", "person", "place"]].itertuples(index=False)):
        if garment == WITH and len(partners[i]):
            first.setdefault(tuple(key), (int(partners[i][0]), i))
    pairs = list(first.values())
    chosen = np.unique(np.linspace(0, len(pairs) - 1, min(PAIRS, len(pairs))).round().astype(int))
    return [pairs[k] for k in chosen]


def _detector(summary: dict, spec: str, rows: pd.DataFrame, shot: object) -> dict:
    told = summary["detectors"][spec]
    table = [(LABELS[WITH], told[WITH], "--c0"), (LABELS[WITHOUT], told[WITHOUT], "--c1")]
    table += [(name, rates, f"--c{2 + k % 4}") for k, (name, rates) in enumerate(told["controls"].items())]
    gone = hidden(rows, summary["threshold"])

    def worst(garment: str, missed: bool) -> list[dict]:
        mine = rows[(rows["garment"] == garment).to_numpy() & (gone == missed)]
        return [shot(i) for i in mine.sort_values("score", ascending=missed, kind="stable").index[:WORST]]

    by_distance = told.get("by_distance", {})
    return {
        "spec": spec,
        "name": short_name(spec),
        "own": summary["operating_points"][spec],
        "hash": summary["detector_hashes"][spec],
        "rows": table,
        "told": told,
        "groups": {title: list(told[key].items()) for key, title in GROUPS.items() if len(told.get(key, {})) > 1},
        "figure": page.svg(plots.found_by_distance(by_distance, LABELS)) if len(by_distance) > 1 else None,
        "found": worst(WITH, missed=False),
        "missed": worst(WITHOUT, missed=True),
        "alarms": worst(NOBODY, missed=False),
    }


def _shot(subject: pd.Series, pictures: Sequence[Picture], scores: list[tuple[str, float]]) -> dict:
    """Prepare a subject's picture with all boxes, and what each detector makes of the subject."""
    picture = pictures[subject["picture"]]
    scale = min(1.0, 480 / max(picture.width, picture.height))
    told = subject["box"] and page.box(0, [scale * picture.scale * x for x in subject["box"]], 0.0)
    metres = "" if np.isnan(subject["distance"]) else f"{subject['distance']:g} m"
    boxes = [
        page.box(d, [scale * x for x in box[:4]], box[4])
        for d, found in enumerate(picture.boxes.values())
        for box in found
    ]
    return {
        "image": picture.thumbnail,
        "width": round(picture.width * scale),
        "height": round(picture.height * scale),
        "told": told,
        "boxes": boxes,
        "label": " · ".join(filter(None, (subject["person"], subject["scene"], metres))) or subject["file"],
        "garment": LABELS.get(subject["garment"], subject["garment"]),
        "file": subject["file"] + (f" frame {picture.frame}" if picture.frame else ""),
        "scores": scores,
    }
