# SPDX-License-Identifier: GPL-3.0-or-later
"""What the trainer's judges found out, why nothing can be shown or judged, and exports of a body that wears a run.

`cloak evaluate` and `cloak wear` give each detector's rates in the same form.
"""

import re
import shutil
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain, groupby
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
from ..trainer.program import SAMPLES
from ..trainer.progress import finite
from ..training.runs import export_of, exported_scene, first_pose, is_cloth, run_of, side_folder

UNREADABLE = (InputError, OSError, KeyError, TypeError, ValueError, AttributeError, IndexError)
"""What a record that somebody damaged may raise."""


THRESHOLD = 0.6  # of records that do not say theirs
SUMMARY = Path("evaluation", "summary.json")
CONTROLS = {"logo": "Cloak", "clothing": "Own clothing", "grey": "Grey", "random": "Random"}
"""What is compared, by its name in the summary, and its name in the panel."""


@dataclass(frozen=True)
class Rate:
    """A share of images in which one detector reports no person, with its 95 % interval; None where unknown."""

    spec: str
    name: str  # what is worn: of `CONTROLS`, or a run
    threshold: float  # the score from which on a person counts as reported
    value: float | None
    low: float | None
    high: float | None

    def describe(self) -> str:
        """94 % (88 to 97)."""
        if self.value is None:
            return "–"
        span = "" if self.low is None or self.high is None else f" ({100 * self.low:.0f}–{100 * self.high:.0f})"
        return f"{self.value:.0%}{span}"


@dataclass(frozen=True)
class Sector:
    """Success at one azimuth, of several detectors the lowest."""

    azimuth: float  # degrees; 0 looks at the front, positive ones stand to the body's left
    cloak: float
    clothing: float | None  # of the body in its own clothing: where that is high, the cloak has nothing to hide
    images: int


@dataclass(frozen=True)
class Evaluation:
    """An evaluation."""

    detectors: tuple[str, ...]
    rates: tuple[Rate, ...]  # by detector: at the common threshold, then at its own
    sectors: tuple[Sector, ...]
    threshold: float
    images: int
    unseen: dict[str, bool | None]
    """Whether bodies and backgrounds were kept from the training; None where that is not known."""
    outdated: bool = False  # the run has newer colours than the evaluated ones

    def describe(self) -> str:
        """Describe the evaluated images in one line."""
        words = {True: "unseen {}", False: "{} of the training", None: "{} that may have been seen"}
        parts = [words[self.unseen.get(what)].format(what) for what in ("bodies", "backgrounds")]
        return f"{self.images:,} images of each kind, {' and '.join(parts)}"

    def worst(self) -> dict[str, float]:
        """The lowest rate over the detectors at the common threshold, by what is worn."""
        rates = [(rate.value, rate.name) for rate in self.rates if rate.threshold == self.threshold]
        return {name: value for value, name in sorted((r for r in rates if r[0] is not None), reverse=True)}


def read_evaluation(run: Path) -> Evaluation | None:
    """The evaluation in a run folder; None where there is none, or none that can be read."""
    path = run / SUMMARY
    try:
        summary = read_json(path)
        threshold = float(summary.get("settings", {}).get("threshold", THRESHOLD))
        rates, sectors = read_rates(summary, threshold, CONTROLS), _sectors(summary)
        unseen = {what: summary.get("unseen", {}).get(what) for what in ("bodies", "backgrounds")}
        images = int(summary.get("n") or sum(sector.images for sector in sectors))
        outdated = (run / "colors.npy").stat().st_mtime > path.stat().st_mtime
        return Evaluation(tuple(summary["detectors"]), rates, sectors, threshold, images, unseen, outdated)
    except UNREADABLE:
        return None


def read_rates(record: dict, threshold: float, names: Iterable[str] = ()) -> tuple[Rate, ...]:
    """Read the rates of these patterns from a trainer's answer; without names, those of all patterns."""
    rates = []
    for spec, answer in record["detectors"].items():
        own = record.get("operating_points", {}).get(spec)
        known = [(name, answer[name]) for name in names or answer if isinstance(answer.get(name), dict)]
        for at, suffix in ((threshold, ""), *([(own, "_own")] if own not in (None, threshold) else [])):
            for name, told in known:
                values = (told.get(f"success{suffix}"), *(told.get(f"ci95{suffix}") or (None, None)))
                rates.append(Rate(spec, name, at, *map(finite, values)))
    return tuple(rates)


def _sectors(record: dict) -> tuple[Sector, ...]:
    sectors = []
    for name, measured in chain(*(answer.get("by_angle", {}).items() for answer in record["detectors"].values())):
        azimuth, cloak, images = float(name), finite(measured.get("success")), int(measured.get("n") or 0)
        if cloak is not None and images:
            detected = measured.get("n_conditional")  # images in which the body was found in its own clothing
            clothing = 1 - detected / images if isinstance(detected, int) else None
            sectors.append(Sector(azimuth, cloak, clothing, images))
    sectors.sort(key=lambda sector: (sector.azimuth, sector.cloak))
    return tuple(next(group) for _, group in groupby(sectors, key=lambda sector: sector.azimuth))


def kept_back(run: Path) -> bool:
    """Whether the run was trained on Cloak's sample people, some of whom are held out."""
    try:
        inputs = read_json(run / "config.json").get("inputs", {})
        return str(inputs.get("made_from") or inputs.get("scene", "")).startswith(tuple(SAMPLES.values()))
    except (InputError, AttributeError):
        return False


# --- single pictures: the rows of Detector's Eye, Render Check and Try It --------------------------------------------

KINDS = {"clothing": ("Own clothing", (0.84, 0.37, 0.0)), "cloak": ("Cloak", (0.0, 0.55, 0.85))}
"""What is worn in a picture: its name, and the sRGB colour of its boxes."""


@dataclass(frozen=True)
class Sight:
    """What one detector makes of one picture."""

    spec: str
    kind: str  # of `KINDS`
    picture: Path
    score: float  # of the surest person, reported or not
    threshold: float  # the detector reports a person above this score: its own operating point
    boxes: tuple[tuple[float, ...], ...] = ()
    """x1, y1, x2, y2, score; pixels of the picture from its upper left; best first."""

    @property
    def found(self) -> bool:
        return self.score > self.threshold

    def describe(self) -> str:
        """found, 0.97."""
        return f"{'found' if self.found else 'hidden'}, {self.score:.2f}"


def by_detector(sights: Iterable[Sight]) -> dict[str, list[Sight]]:
    """The rows of each detector."""
    rows: dict[str, list[Sight]] = {}
    for sight in sights:
        rows.setdefault(sight.spec, []).append(sight)
    return rows


# --- why nothing can be shown or judged, and what is judged ----------------------------------------------------------


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
    done = export_of(run) if run else None
    bodies, _ = export_bodies(context, obj, choice, done.logo if done else "")
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
    files = [chosen] if chosen.is_file() else sorted(chosen.glob("*.json"), key=lambda p: (p.name != "people.json", p))
    if not files:
        raise InputError(f"{chosen}: no people.json in it (people as COCO has them, with masks and landmarks)")
    return files[0]


@dataclass(frozen=True)
class Worn:
    """What came out of wearing a run."""

    folder: Path
    people: int
    left_out: int
    rates: tuple[Rate, ...]
    pictures: tuple[Path, ...]


def last_worn(run: Path) -> Worn | None:
    """That of the latest wearing of a run; None where there is none."""
    places = sorted(side_folder(run).glob(f"{WEAR}*/{ANSWER}"), key=lambda path: path.stat().st_mtime)
    try:
        record, folder = read_json(places[-1]), places[-1].parent
        left = sum(int(count) for count in (record.get("left_out") or {}).values())
        paths = [path for path in folder.rglob("pictures/*/*") if path.suffix.lower() in PICTURES]
        pictures = sorted(paths, key=lambda path: (path.parent, not path.stem.startswith("before"), path.name))
        return Worn(folder, int(record["people"]), left, read_rates(record, THRESHOLD), tuple(pictures))
    except UNREADABLE:
        return None
