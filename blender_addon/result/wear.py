# SPDX-License-Identifier: GPL-3.0-or-later
"""The run's colours on people in photographs, and what detectors make of them, before and after."""

from dataclasses import dataclass
from pathlib import Path

import bpy

from ..blender.blend_paths import absolute
from ..files.errors import InputError
from ..files.reading import read_json
from ..training.runs import run_of, side_folder
from .evaluations import UNREADABLE, Judged, kept_back, read_judged

WEAR, ANSWER = "worn by people", "answer.json"
PICTURES = (".png", ".jpg", ".jpeg")


def people_file(path: str) -> Path:
    """The COCO file of people that a folder holds, or that was named. Raises `InputError`."""
    if not path:
        raise InputError("People is empty: choose a people.json, or the folder of photographs that it lies in")
    chosen = Path(absolute(path))
    found = [chosen] if chosen.is_file() else sorted(chosen.glob("*.json"), key=lambda p: (p.name != "people.json", p))
    if not found:
        raise InputError(f"{chosen}: no people.json in it (people as COCO has them, with masks and landmarks)")
    return found[0]


@dataclass(frozen=True)
class Worn:
    """What came out of wearing a run."""

    folder: Path
    people: int
    left_out: int
    detectors: tuple[Judged, ...]
    pictures: tuple[Path, ...]


def last_worn(run: Path) -> Worn | None:
    """That of the latest wearing of a run; None where there is none."""
    places = sorted(side_folder(run).glob(f"{WEAR}*/{ANSWER}"), key=lambda path: path.stat().st_mtime)
    try:
        record, folder = read_json(places[-1]), places[-1].parent
        left = sum(int(count) for count in (record.get("left_out") or {}).values())
        found = [path for path in folder.rglob("pictures/*/*") if path.suffix.lower() in PICTURES]
        pictures = sorted(found, key=lambda path: (path.parent, not path.stem.startswith("before"), path.name))
        return Worn(folder, int(record["people"]), left, read_judged(record), tuple(pictures))
    except UNREADABLE:
        return None


def foreign_reason(obj: bpy.types.Object) -> str:
    """Why people in photographs cannot wear a body's run: they are fitted with the faces of Cloak's own people."""
    run = run_of(obj)
    if obj.cloak.made_from or kept_back(run) or (run / "zoo.json").is_file() or (run / "cloth.png").is_file():
        return ""
    return (
        f"People in photographs wear what was trained on Cloak's own people, and '{obj.name}' is none of them: train "
        "on the sample body, or carry the colours over (cloak logo transfer)"
    )
