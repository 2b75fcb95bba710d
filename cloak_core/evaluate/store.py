"""The folder an evaluation leaves behind: summary.json, scores.npz, pictures.json and pictures/."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cloak_core.evaluate.measurement import Measurement, read_measurement
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json

FOLDER = "evaluation"
"""Name of the folder inside a run."""


@dataclass(frozen=True)
class StoredEvaluation:
    """An evaluation read back."""

    folder: Path
    summary: dict
    pictures: dict
    measurement: Measurement


def check_folder(folder: Path) -> Path:
    """InputError when the folder holds something that is no evaluation; asked before the work begins, too."""
    folder = Path(folder)
    if folder.exists() and not (folder.is_dir() and ((folder / "summary.json").exists() or not any(folder.iterdir()))):
        raise InputError(f"{folder}: holds something that is no evaluation, and is left alone")
    return folder


def read_evaluation(folder: Path) -> StoredEvaluation:
    """Read what `store_evaluation` wrote; InputError names what is missing or damaged."""
    return StoredEvaluation(
        folder=folder,
        summary=read_json(folder / "summary.json"),
        pictures=read_json(folder / "pictures.json"),
        measurement=read_measurement(folder / "scores.npz"),
    )
