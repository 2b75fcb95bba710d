"""Judge photographs from beginning to end: who is in them, what detectors report, rates, a report."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import UInt8
from PIL import Image, ImageOps

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.outcomes import on_body
from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.detector.scoring import max_person_score, person_boxes
from cloak_core.core.evaluation.measure import OnProgress, image_scores, kept_frozen
from cloak_core.core.evaluation.settings import JudgeSettings
from cloak_core.core.evaluation.statistics import undetected
from cloak_core.core.pictures import open_picture
from cloak_core.files.errors import InputError
from cloak_core.files.records import as_cell
from cloak_core.files.writing import write_json, write_text, written
from cloak_core.sources.bodies import videos
from cloak_core.studies.judging.listing import NOBODY, WITH, WITHOUT, Subject, list_subjects
from cloak_core.studies.report import page, plots
from cloak_core.studies.report.page import jpeg_uri
from cloak_core.studies.report.stored import check_folder
from cloak_core.studies.report.words import short_name
from cloak_core.studies.statistics_photographs import clean_scores, find_partners, summarize_photographs

THUMBNAIL = 480
"""Longer side of what the report keeps of a picture, pixels."""
MOST_THUMBNAILS = 2000
_log = logging.getLogger("cloak")


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


def judge(
    folder: Path,
    detectors: Mapping[str, Detector],
    settings: JudgeSettings | None = None,
    *,
    table: Path | None = None,
    boxes: Path | None = None,
    out: Path | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Judge the photographs and videos of a folder (see `listing`); contract C7's figures.

    out: takes report.html, summary.json and scores.csv, a line for each subject. InputError: nothing to judge, a bad
    table, something else in `out`.
    """
    settings = settings or JudgeSettings()
    if not detectors:
        raise InputError("--detector: none given")
    if out is not None:
        check_folder(out)
    subjects = list_subjects(folder, table, boxes, [] if out is None else [out])
    with kept_frozen(detectors) as hashes:
        rows, pictures, skipped = look(folder, subjects, detectors, settings, on_progress)
    summary = summarize_photographs(rows, settings.threshold, settings.resamples)
    summary |= {"pictures": len(pictures), "skipped": skipped}
    summary |= {"settings": asdict(settings), "detector_hashes": hashes}
    if out is None:
        return summary
    with written(out):
        out.mkdir(parents=True, exist_ok=True)
    write_json(out / "summary.json", summary)  # first: it marks the folder as a judge's own
    write_text(out / "scores.csv", _table_text(rows))
    report = write_report(out / "report.html", folder.resolve().name, summary, rows, pictures)
    return summary | {"report": str(report)}


@torch.no_grad()
def look(
    folder: Path,
    subjects: Sequence[Subject],
    detectors: Mapping[str, Detector],
    settings: JudgeSettings,
    on_progress: OnProgress | None = None,
) -> tuple[pd.DataFrame, list[Picture], list[str]]:
    """Show every picture to every detector; return a row per detector and subject, the pictures, and what was skipped.

    Columns: those of `Subject`, place, boxed (whether a box is told), picture (its number), frame, detector,
    operating_point, score (the best of a person: on the subject's box where one is told, else anywhere in the
    picture), clean (the score it is compared with, see `clean_scores`), other and other_name (as in `Results`; only
    where a box is told). A file that cannot be read is skipped with a warning. InputError: no picture with or without
    the cloak can be read.
    """
    by_file: dict[str, list[Subject]] = {}
    for subject in subjects:
        by_file.setdefault(subject.file, []).append(subject)
    rows, pictures, skipped = [], [], []
    for done, (file, people) in enumerate(by_file.items()):
        seen = []
        try:
            for number, frame in enumerate(_read(folder / file, settings)):
                shown = _reduced(frame, settings.longest)
                seen.append(_look_at((file, number * settings.every), *shown, people, detectors, settings))
        except InputError as error:
            seen = []  # half a video
            skipped.append(str(error).removeprefix(f"{folder}/"))  # others need not know where it lay
            _log.warning("%s; skipped", error)
        for picture, detections in seen:
            rows += [row | {"picture": len(pictures)} for row in detections]
            pictures.append(picture if len(pictures) < MOST_THUMBNAILS else replace(picture, thumbnail=""))
        if on_progress:
            on_progress(done + 1, len(by_file))
    if not any(row["garment"] in (WITH, WITHOUT) for row in rows):
        worn = {one.file for one in subjects if one.garment in (WITH, WITHOUT)}
        raise InputError(f"{folder}: none of its {len(worn)} pictures with or without the cloak can be read")
    return _compared(pd.DataFrame(rows), list(detectors)), pictures, skipped


def _compared(rows: pd.DataFrame, detectors: Sequence[str]) -> pd.DataFrame:
    """Add the score that each subject is compared with; put a detector's rows together."""
    table = rows.astype({"distance": float, "score": np.float32, "other": np.float32})
    by_detector = [table[(table["detector"] == spec).to_numpy()].reset_index(drop=True) for spec in detectors]
    partners, garment = find_partners(by_detector[0]), by_detector[0]["garment"].to_numpy()
    compared = []
    for one in by_detector:
        # Another class that is reported on the same person without the cloak, too, is left out: a bag is no new name.
        names, other = one["other_name"].to_numpy(), one["other"].to_numpy()
        reported = other > np.minimum(one["operating_point"].to_numpy(), THRESHOLD)
        own = [bool(name) and name in names[p[reported[p]]] for name, p in zip(names, partners, strict=True)]
        own &= garment != WITHOUT
        changed = one.assign(other=np.where(own, np.float32(0), other), other_name=np.where(own, "", names))
        compared.append(changed.assign(clean=clean_scores(one["score"].to_numpy(), garment, partners)))
    return pd.concat(compared, ignore_index=True).astype({"clean": np.float32})


def _look_at(
    named: tuple[str, int],
    image: UInt8[np.ndarray, "h w 3"],
    scale: float,
    people: Sequence[Subject],
    detectors: Mapping[str, Detector],
    settings: JudgeSettings,
) -> tuple[Picture, list[dict]]:
    """Show one picture (file and frame) to every detector: what is kept of it, and a row per subject and detector."""
    rows, boxes = [], {}
    for spec, detector in detectors.items():
        detections = detector(torch.from_numpy(image).to(detector.device).permute(2, 0, 1)[None].float() / 255)
        point = float(detector.operating_point)
        boxes[spec] = person_boxes(detections, min(settings.threshold, point))[0].tolist()
        for one in people:
            label = vars(one) | {"place": one.place, "boxed": one.box is not None, "frame": named[1]}
            figures = {"detector": spec, "operating_point": point, "other": math.nan, "other_name": ""}
            rows.append(label | figures | _scores(detector, detections, one.box, scale, settings.iou))
    small = Image.fromarray(image)
    small.thumbnail((THUMBNAIL, THUMBNAIL))
    return Picture(*named, image.shape[1], image.shape[0], scale, boxes, jpeg_uri(small, quality=88)), rows


def _scores(detector: Detector, detections: Detections, box: tuple | None, scale: float, iou: float) -> dict:
    """Tell what is reported of one person, as columns; of other classes only where the person's box is known."""
    if box is None:
        return {"score": float(max_person_score(detections)[0])}
    true = torch.tensor([box], dtype=torch.float32) * scale
    scores = image_scores(detector, detections, on_body(detections, true, iou, within=math.inf))
    scores["score"] = scores.pop("score_on")
    return {name: values[0] for name, values in scores.items()}


def _read(path: Path, settings: JudgeSettings) -> Iterator[Image.Image]:
    """Read a photograph, upright, or every `settings.every`-th frame of a video."""
    if path.suffix.lower() in videos.SUFFIXES:
        yield from map(Image.fromarray, videos.read_frames(path, settings.every, settings.most_frames))
    else:
        with open_picture(path) as picture:
            upright = ImageOps.exif_transpose(picture).convert("RGB")
        yield upright


def _reduced(picture: Image.Image, longest: int) -> tuple[UInt8[np.ndarray, "h w 3"], float]:
    """Make a picture's longer side at most `longest` pixels; also the scale."""
    scale = min(1.0, longest / max(picture.size))
    if scale < 1:
        size = tuple(max(1, round(side * scale)) for side in picture.size)
        picture = picture.resize(size, Image.Resampling.BOX if scale < 0.5 else Image.Resampling.LANCZOS)
    return np.array(picture), scale


def _table_text(rows: pd.DataFrame) -> str:
    """List every subject in every picture with each detector's score, as CSV."""
    columns = {"file": "file", "frame": "frame", "garment": "cloak"}
    columns |= {name: name for name in ("person", "scene", "distance", "pair", "box")}
    by_detector = dict(list(rows.groupby("detector", sort=False)))
    table = next(iter(by_detector.values()))[[*columns]].rename(columns=columns)
    table["box"] = ["" if box is None else " ".join(f"{x:g}" for x in box) for box in table["box"]]
    scores = {spec: [f"{score:.4f}" for score in group["score"]] for spec, group in by_detector.items()}
    return table.assign(**scores).map(as_cell).rename(columns=as_cell).to_csv(index=False, lineterminator="\n")


# --- the report: what the template judge.html shows

PAIRS, WORST = 8, 6
LABELS = {WITH: "with the cloak", WITHOUT: "without"}


def write_report(path: Path, name: str, summary: dict, rows: pd.DataFrame, pictures: Sequence[Picture]) -> Path:
    """Write the report of `judge` and return its path; rows, pictures: what `look` returned."""
    by_detector = {
        str(spec): group.reset_index(drop=True) for spec, group in rows.groupby("detector", sort=False, observed=True)
    }
    subjects = next(iter(by_detector.values()))
    scores = [(short_name(spec), group["score"].to_numpy()) for spec, group in by_detector.items()]
    shot = lambda i: _shot(subjects.loc[i], pictures, [(name, float(score[i])) for name, score in scores])
    values = {
        "name": name,
        "summary": summary,
        "detectors": [_detector(summary, spec, group, shot) for spec, group in by_detector.items()],
        "pairs": [[shot(i) for i in pair] for pair in shown_pairs(subjects)],
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
    gone = undetected(rows, summary["threshold"])

    def worst(garment: str, missed: bool) -> list[dict]:
        candidates = rows[(rows["garment"] == garment).to_numpy() & (gone == missed)]
        return [shot(i) for i in candidates.sort_values("score", ascending=missed, kind="stable").index[:WORST]]

    return {
        "spec": spec,
        "name": short_name(spec),
        "figures": page.figures(plots.found_by_distance, summary["detectors"][spec].get("by_distance", {}), LABELS),
        "found": worst(WITH, missed=False),
        "missed": worst(WITHOUT, missed=True),
        "alarms": worst(NOBODY, missed=False),
    }


def _shot(subject: pd.Series, pictures: Sequence[Picture], scores: list[tuple[str, float]]) -> dict:
    """Prepare a subject's picture with all boxes, and what each detector makes of the subject."""
    picture = pictures[subject["picture"]]
    scale = min(1.0, 480 / max(picture.width, picture.height))
    person_box = subject["box"] and page.box(0, [scale * picture.scale * x for x in subject["box"]], 0.0)
    metres = "" if np.isnan(subject["distance"]) else f"{subject['distance']:g} m"
    boxes = [
        page.box(d, [scale * x for x in box[:4]], box[4])
        for d, detector_boxes in enumerate(picture.boxes.values())
        for box in detector_boxes
    ]
    return {
        "image": picture.thumbnail,
        "width": round(picture.width * scale),
        "height": round(picture.height * scale),
        "told": person_box,
        "boxes": boxes,
        "label": " · ".join(filter(None, (subject["person"], subject["scene"], metres))) or subject["file"],
        "garment": LABELS.get(subject["garment"], subject["garment"]),
        "file": subject["file"] + (f" frame {picture.frame}" if picture.frame else ""),
        "scores": scores,
    }
