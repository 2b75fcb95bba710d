"""What a report needs of an evaluation's summary.json and pictures.json, which may come with anybody's run."""

from __future__ import annotations

from pathlib import Path

from cloak_core.core.evaluation.results import Results
from cloak_core.files.errors import InputError
from cloak_core.files.shapes import FLAG, NOTHING, NUMBER, SHARE, TEXT, WHOLE, Kind, check_shape

_BOUNDS = Kind(
    "two numbers from 0 to 1",
    lambda value: isinstance(value, list) and len(value) == 2 and all((SHARE | NOTHING).fits(x) for x in value),
)
_BOX = Kind(
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
_SHOT = {"file": TEXT, "scores": {"*": NUMBER}, "boxes": {"*": [_BOX]}}
_PAIR = {"body": TEXT | NOTHING, "angle": NUMBER | NOTHING, "distance?": NUMBER | NOTHING, "background": TEXT | NOTHING}
_PAIR |= {"clothing": _SHOT, "logo": _SHOT}


def check_stored(folder: Path, summary: dict, pictures: dict, results: Results) -> None:
    """Check an evaluation's files against what a report shows. InputError: the file and the place that do not fit."""
    controls = results.controls
    detector = {control: _SUCCESS for control in controls}
    detector |= {"by_body": {"*": {}}, "average_precision": {control: SHARE | NOTHING for control in controls}}
    specs = results.detectors
    shape = {
        "n": WHOLE,
        "detectors": {spec: detector for spec in specs},
        "false_alarms": {spec: SHARE | NOTHING for spec in specs},
        "unseen": {"*": FLAG | NOTHING},
        "warnings": [TEXT],
        "operating_points?": {"*": NUMBER | NOTHING},
        "white_box?": {"*": FLAG | NOTHING},
        "settings": {"threshold": SHARE, "size": WHOLE, "angles?": [NUMBER], "distances?": [NUMBER]},
        "inputs": {"bodies?": [TEXT], "detector_hashes": {spec: TEXT for spec in specs}},
    }
    path = folder / "summary.json"
    check_shape(summary, shape, str(path))
    if set(summary["detectors"]) != set(specs):
        raise InputError(f"{path}: detectors are {', '.join(summary['detectors'])}, in scores.npz {', '.join(specs)}")
    shown = {
        "thresholds?": {spec: NUMBER for spec in specs},
        "gallery": [_PAIR],
        "failures": {"*": [_PAIR]},
        "worst?": {"*": [_PAIR | {"success": SHARE}]},
        "controls": {key: kind for key, kind in _PAIR.items() if key not in ("clothing", "logo")}
        | {"images": {control: _SHOT for control in controls}},
        "flat": {"*": TEXT},
        "turntable?": TEXT,
    }
    check_shape(pictures, shown, str(folder / "pictures.json"))
