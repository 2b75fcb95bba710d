"""The folder of an evaluation, read back: its files may come with anybody's run, so that all are checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cloak_core.core.evaluation.results import Results, read_results
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.records import FLAG, NOTHING, NUMBER, SHARE, TEXT, WHOLE, Kind, check_shape

FOLDER, PEOPLE_FOLDER = "evaluation", "evaluation-people"
"""Names of the folders inside a run: of bodies, and of people in photographs."""


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
    known = (folder / "summary.json").exists() or is_earlier_on_people(folder)
    if folder.exists() and not (folder.is_dir() and (known or not any(folder.iterdir()))):
        raise InputError(f"{folder}: holds something that is no evaluation, and is left alone")
    return folder


def is_earlier_on_people(folder: Path) -> bool:
    """Tell whether a folder holds a run's evaluation on photographs as earlier versions wrote it (wear.json)."""
    path = folder / "wear.json"
    # What `cloak wear` writes says nothing of a training.
    return path.is_file() and "white_box" in read_json(path)


# --- what a report needs of summary.json and pictures.json

_BOUNDS = Kind(
    "two numbers from 0 to 1",
    lambda value: isinstance(value, list) and len(value) == 2 and all((SHARE | NOTHING).fits(x) for x in value),
)
BOX = Kind(
    "a box x1, y1, x2, y2 and its score",
    lambda value: isinstance(value, list) and len(value) == 5 and all(map(NUMBER.fits, value)),
)
_NAMED = Kind(
    "a record of counts",
    lambda value: isinstance(value, dict) and all(map(WHOLE.fits, value.values())),
)
_SUCCESS = {
    "success": SHARE | NOTHING,
    "ci95": _BOUNDS,
    "success_iou": SHARE | NOTHING,
    "conditional": SHARE | NOTHING,
    "n": WHOLE,
    "success_own?": SHARE | NOTHING,
    "ci95_own?": _BOUNDS | NOTHING,
    "renamed?": SHARE | NOTHING,
    "renamed_own?": SHARE | NOTHING,
    "gone?": SHARE | NOTHING,
    "named?": _NAMED | NOTHING,
}
_SHOT = {"file": TEXT, "scores": {"*": NUMBER}, "boxes": {"*": [BOX]}}
_TRIAL = {
    "body": TEXT | NOTHING,
    "angle": NUMBER | NOTHING,
    "distance?": NUMBER | NOTHING,
    "background": TEXT | NOTHING,
}
_PAIR = _TRIAL | {"clothing": _SHOT, "logo": _SHOT}


def read_evaluation(folder: Path) -> StoredEvaluation:
    """Read what `write_evaluation` wrote; InputError names what is missing, damaged or of another type."""
    summary, pictures = read_json(folder / "summary.json"), read_json(folder / "pictures.json")
    results = read_results(folder / "scores.npz")
    controls, specs = results.controls, results.detectors
    detector = dict.fromkeys(controls, _SUCCESS)
    detector |= {"by_body": {"*": {}}, "average_precision": dict.fromkeys(controls, SHARE | NOTHING)}
    shape = {
        "n": WHOLE,
        "detectors": dict.fromkeys(specs, detector),
        "false_alarms": dict.fromkeys(specs, SHARE | NOTHING),
        "unseen": {"*": FLAG | NOTHING},
        "warnings": [TEXT],
        "operating_points?": {"*": NUMBER | NOTHING},
        "white_box?": {"*": FLAG | NOTHING},
        "settings": {"threshold": SHARE, "size": WHOLE, "angles?": [NUMBER], "distances?": [NUMBER]},
        "inputs": {"bodies?": [TEXT], "detector_hashes": dict.fromkeys(specs, TEXT)},
    }
    path = folder / "summary.json"
    check_shape(summary, shape, str(path))
    if set(summary["detectors"]) != set(specs):
        raise InputError(f"{path}: detectors are {', '.join(summary['detectors'])}, in scores.npz {', '.join(specs)}")
    shown = {
        "thresholds?": dict.fromkeys(specs, NUMBER),
        "gallery": [_PAIR],
        "failures": {"*": [_PAIR]},
        "worst?": {"*": [_PAIR | {"success": SHARE}]},
        "controls": _TRIAL | {"images": dict.fromkeys(controls, _SHOT)},
        "flat": {"*": TEXT},
        "turntable?": TEXT,
    }
    check_shape(pictures, shown, str(folder / "pictures.json"))
    return StoredEvaluation(folder, summary, pictures, results)
