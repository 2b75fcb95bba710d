"""Writes an evaluation's folder: at once, so that a reader meets the old one or the new one."""

from __future__ import annotations

import shutil
from pathlib import Path

from cloak_core.detectors.protocol import Detector
from cloak_core.evaluate.measurement import Measurement
from cloak_core.evaluate.pictures import write_pictures
from cloak_core.evaluate.stage import Stage
from cloak_core.evaluate.store import check_folder
from cloak_core.files.writing import new_folder, write_json


def store_evaluation(
    folder: Path, summary: dict, measurement: Measurement, stage: Stage, detectors: dict[str, Detector]
) -> None:
    """Write everything at once; an earlier evaluation there is replaced when the new one is complete."""
    folder = check_folder(folder)
    fresh = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    with new_folder(fresh) as temporary:
        (temporary / "pictures").mkdir()
        threshold = summary["settings"]["threshold"]
        shown = write_pictures(temporary / "pictures", stage, measurement, detectors, threshold)
        write_json(temporary / "pictures.json", shown)
        measurement.save(temporary / "scores.npz")
        write_json(temporary / "summary.json", summary)
    # Renames only: a reader never meets half of an evaluation, and a crash in between loses none.
    old = folder.with_name(f"{folder.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    fresh.rename(folder)
    shutil.rmtree(old, ignore_errors=True)
