"""Photographs judged from beginning to end: who is in them, what detectors say, rates, a report."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from cloak_core.detectors.protocol import Detector, state_hash
from cloak_core.evaluation.evaluation_folder import check_folder
from cloak_core.evaluation.inference import OnProgress
from cloak_core.evaluation.photographs.counting import summarize
from cloak_core.evaluation.photographs.listing import list_subjects
from cloak_core.evaluation.photographs.looking import Looks, look
from cloak_core.evaluation.photographs.page import write_page
from cloak_core.evaluation.photographs.settings import JudgeSettings
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json, write_text, written


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
    """Judge the photographs and videos of a folder (see `listing`); contract C7's figures (see `counting`).

    out: takes report.html, summary.json and scores.csv, a line for everybody in every picture. InputError: nothing to
    judge, a table that is none, something else in `out`.
    """
    settings = settings or JudgeSettings()
    if not detectors:
        raise InputError("--detector: none given")
    if out is not None:
        check_folder(out)
    subjects = list_subjects(folder, table, boxes, [] if out is None else [out])
    hashes = {spec: state_hash(detector) for spec, detector in detectors.items()}
    looks = look(folder, subjects, detectors, settings, on_progress)
    for spec, detector in detectors.items():
        detector.verify(hashes[spec])
    summary = summarize(looks, settings) | {"settings": asdict(settings), "detector_hashes": hashes}
    if out is None:
        return summary
    with written(out):
        out.mkdir(parents=True, exist_ok=True)
    write_json(out / "summary.json", summary)  # first: by this the folder is known again
    write_text(out / "scores.csv", _scores(looks))
    report = write_page(out / "report.html", folder.resolve().name, summary, looks)
    return summary | {"report": str(report)}


def _scores(looks: Looks) -> str:
    """Everybody in every picture, and each detector's score."""
    text = io.StringIO()
    columns = ("file", "frame", "cloak", "person", "scene", "distance", "pair", "box")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*columns, *looks.specs])
    for i, (one, at) in enumerate(zip(looks.subjects, looks.picture, strict=True)):
        box = "" if one.box is None else " ".join(f"{x:g}" for x in one.box)
        row = [one.file, looks.pictures[at].frame, one.garment, one.person, one.scene, one.distance, one.pair, box]
        writer.writerow([*row, *(f"{score:.4f}" for score in looks.score[:, i])])
    return text.getvalue()
