# SPDX-License-Identifier: GPL-3.0-or-later
"""Why the colours of a run cannot be shown or judged; exports of a body that wears them, and people that did."""

import re
import shutil
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import bpy

from ..blender.blend_paths import absolute
from ..body.garments import is_dressed, worn_by
from ..body.objects import of_the_body, refusal
from ..exchange.bodies import Bodies
from ..exchange.face_lists import read_face_list
from ..exchange.scenes import write_scene
from ..files.errors import InputError
from ..files.reading import read_json
from ..poses.export import export_bodies
from ..poses.poses import PoseChoice
from ..training.run_list import read_state
from ..training.runs import export_of, exported_scene, first_pose, is_cloth, run_of, side_folder
from .evaluations import UNREADABLE, Judged, read_judged


@of_the_body
def result_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there are no colours to show."""
    if not obj.cloak.run:
        return f"'{obj.name}' has no training yet: press Start, or choose a run in the list"
    run = run_of(obj)
    if not run.is_dir():
        return f"{run}: no such run folder"
    return "" if (run / "colors.npy").is_file() else f"{run.name}: no colours yet; wait for the first step"


@of_the_body
def judged_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why nothing can be made of the body's run: no evaluation, no sheets to print, no film."""
    return result_reason(context) or worn_reason(obj) or refusal(require_same_clothes, obj, run_of(obj))


def worn_reason(obj: bpy.types.Object) -> str:
    """Why what is on the model is not what would be judged; "" when it is."""
    worn, run = obj.cloak.worn, run_of(obj)
    if not worn or run is None or Path(worn) == run or not is_dressed(obj):
        return ""
    return f"The model wears {Path(worn).name}, chosen is {run.name}: press Load Colours"


def export_worn(
    context: bpy.types.Context, obj: bpy.types.Object, run: Path | None, choice: PoseChoice, folder: Path
) -> Bodies:
    """A scene package in `folder` (replaced) of what the camera sees, with the faces that the run's colours are for.

    A cloth lies on the bodies as it does in the training and in Blender, whatever poses these are. Raises `InputError`
    where the faces are not those of the training, and says which piece is there or is missing.
    """
    expected = read_face_list(run / "logo.npy").topology if run else None
    require_same_clothes(obj, run)
    bodies, _ = export_bodies(context, obj, choice, read_state(run).logo if run else "")
    if expected not in (None, bodies.topology):
        raise InputError(
            f"'{obj.name}' changed since {run.name} was trained: its faces, or those of its clothing, are others; undo "
            "the change, or train again"
        )
    laid_out = first_pose(obj, exported_scene(run)).vertices[0] if is_cloth(run) else None
    if laid_out is not None and laid_out.shape == bodies.vertices[0].shape:
        bodies = replace(bodies, laid_out=laid_out, recorded_topology=bodies.topology)
    shutil.rmtree(folder, ignore_errors=True)
    write_scene(folder, bodies, creator="cloak add-on")
    return bodies


def require_same_clothes(obj: bpy.types.Object, run: Path | None) -> None:
    """Raise `InputError` if the visible objects differ from those of the training, where the run records them."""
    done = export_of(run) if run else None
    names = done.objects if done else []
    # A copied or appended character's pieces have numbers behind their names.
    then = Counter(map(_unnumbered, names[1:]))
    now = Counter(_unnumbered(o.name) for o in worn_by(obj) if names)
    for name in sorted(now - then):
        raise InputError(f"{run.name} was trained without '{name}': leave it out (step 1), or train again")
    for name in sorted(then - now):
        raise InputError(f"{run.name} was trained with '{name}': show it again, or train again")


def _unnumbered(name: str) -> str:
    return re.sub(r"\.\d{3,}$", "", name)


# --- people in photographs -------------------------------------------------------------------------------------------

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
