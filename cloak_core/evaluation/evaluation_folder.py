"""Read and write an evaluation's folder: summary.json, scores.npz, pictures.json and pictures/."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.film.film import write_turntable
from cloak_core.evaluation.renderer import BodyRenderer, EvaluationRenderer
from cloak_core.evaluation.report.pictures import write_pictures
from cloak_core.evaluation.results import Results, read_results
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import new_folder, write_json

FOLDER = "evaluation"
"""Name of the folder inside a run."""


@dataclass(frozen=True)
class StoredEvaluation:
    """An evaluation read back."""

    folder: Path
    summary: dict
    pictures: dict
    results: Results


def check_folder(folder: Path) -> Path:
    """Refuse a folder that holds something that is no evaluation (InputError); asked before the work begins, too."""
    folder = Path(folder)
    if folder.exists() and not (folder.is_dir() and ((folder / "summary.json").exists() or not any(folder.iterdir()))):
        raise InputError(f"{folder}: holds something that is no evaluation, and is left alone")
    return folder


def read_evaluation(folder: Path) -> StoredEvaluation:
    """Read what `write_evaluation` wrote; InputError names what is missing or damaged."""
    return StoredEvaluation(
        folder=folder,
        summary=read_json(folder / "summary.json"),
        pictures=read_json(folder / "pictures.json"),
        results=read_results(folder / "scores.npz"),
    )


def write_evaluation(
    folder: Path, summary: dict, results: Results, renderer: EvaluationRenderer, detectors: dict[str, Detector]
) -> None:
    """Write everything at once; an earlier evaluation there is replaced when the new one is complete."""
    folder = check_folder(folder)
    fresh = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    with new_folder(fresh) as temporary:
        (temporary / "pictures").mkdir()
        threshold = summary["settings"]["threshold"]
        shown = write_pictures(temporary / "pictures", renderer, results, detectors, threshold)
        turntable, trial = temporary / "pictures/turntable.gif", shown["controls"]["trial"]
        ours = type(renderer) is BodyRenderer  # a turntable is our render, of a body
        if ours and write_turntable(turntable, renderer, trial, detectors, threshold, len(results.controls)):
            shown["turntable"] = turntable.name
        write_json(temporary / "pictures.json", shown)
        results.save(temporary / "scores.npz")
        write_json(temporary / "summary.json", summary)
    # Renames only: a reader never meets half of an evaluation, and a crash in between loses none.
    old = folder.with_name(f"{folder.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    fresh.rename(folder)
    shutil.rmtree(old, ignore_errors=True)
