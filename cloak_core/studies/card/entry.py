"""A card's folder as it joins a leaderboard: its files are read, checked, bounded, and written anew.

Nothing else of a folder is read, no link in it is followed, and what can be computed from the rows is.
"""

from __future__ import annotations

import fnmatch
import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from cloak_core.core.evaluate import bare_backgrounds
from cloak_core.core.evaluation.results import NOBODY, TRUE_BOX, Results, pool, read_results
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.trials import COLUMNS
from cloak_core.core.pictures import open_picture, save_picture
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays, sha256_record
from cloak_core.files.reading import MAX_JSON_BYTES, is_number, read_json
from cloak_core.files.records import FLAG, NOTHING, NUMBER, SHARE, Kind, check_shape
from cloak_core.files.writing import new_folder, write_json
from cloak_core.sources.photographs.fits import UNCOVERED, UNFIT
from cloak_core.studies.card.figures import card_of, differences, fixed
from cloak_core.studies.card.page import FLAT, PAGES, SIDES, place_of, read_card
from cloak_core.studies.card.protocol import (
    AGAINST,
    GREY_HEAD,
    HEADS,
    ROWS,
    SIZES,
    UNTRAINED,
    Part,
    Size,
    keep_rows,
    parts_of,
)
from cloak_core.studies.report.page import MAX_PICTURE
from cloak_core.studies.report.pictures import SAVING, describe
from cloak_core.studies.report.stored import BOX
from cloak_core.studies.report.words import file_name

MAX_ROWS = 64 << 20
"""Bytes of a file of rows."""
DESCRIBED = ("trial", "body", "angle", "distance", "background")
"""What pictures.json says of a picture's trial."""
LISTED = ("card.json", "pictures.json", f"{ROWS}/*.npz", "pictures/*/*.jpg", "pictures/*/*.png", *PAGES)
"""All that a card's folder in a leaderboard holds."""

# --- what a card says itself; all else in card.json is computed from its rows and its size
#
# Provenance (`made`, names of bodies, seconds) can be held against nothing; every other value decides what the rows
# have to be, or has to be that of the other cards of a leaderboard.

MOST_TEXT = 4096


def _is_text(value: object) -> bool:
    return isinstance(value, str) and len(value) <= MOST_TEXT and value.isprintable()


TEXT = Kind("a line of text", _is_text)
NAME = Kind("a name", lambda value: _is_text(value) and bool(re.fullmatch(r"[^/\\]+", value)))
FILE = Kind("the name of a picture", lambda value: _is_text(value) and bool(re.fullmatch(r"[\w-]+\.(jpg|png)", value)))
DIGEST = Kind("a SHA-256", lambda value: isinstance(value, str) and bool(re.fullmatch("[0-9a-f]{64}", value)))
COUNT = Kind("a count", lambda value: is_number(value) and isinstance(value, int) and 0 <= value < 1 << 31)

BODIES = {"name": TEXT, "poses": [TEXT], "outfits": COUNT, "faces": COUNT, "sha256": DIGEST}
BACKGROUNDS = {"count": COUNT, "sha256": DIGEST}
UNSEEN = {"bodies?": FLAG | NOTHING, "backgrounds?": FLAG | NOTHING}
CARD = {
    "spec": TEXT,
    "size": TEXT,
    "operating_point": SHARE,
    "operating_point_assumed": FLAG,
    "differentiable": FLAG,
    "partial_gradient": TEXT,
    "cover?": TEXT,
    "made": dict.fromkeys(("cloak", "command", "python", "torch", "numpy", "platform"), TEXT)
    | {"seed": COUNT, "threads": COUNT},
    "materials": {
        "bodies": BODIES,
        "unseen": BODIES,
        "backgrounds": BACKGROUNDS,
        "unseen_backgrounds": BACKGROUNDS,
        "detectors": {"*": DIGEST},
        "shown_people?": {"count": COUNT, "photographs": COUNT, "sha256": DIGEST},
    },
    "left_patterns": [NAME],
    "white_box": [{"area": SHARE, "faces": COUNT}],
    "black_box": {"zoo": [{"name": NAME, "trained_against_it": FLAG, "unseen": UNSEEN, "area": SHARE}]},
    "patterns": [{"name": NAME}],
    "photographs?": {"left_out": {"*": COUNT}},
    "seconds": NUMBER,
}
"""What card.json says itself."""

SHOT = {"file": FILE, "boxes": {"*": [BOX]}, "scores": {"*": SHARE}}
TRIAL = {"trial": COUNT, "body": TEXT, "angle": NUMBER, "distance": NUMBER, "background": TEXT}
PICTURES = {
    "missed": [TRIAL | {"clothing": SHOT}],
    "alarms": [{"background": TEXT, "bare": SHOT}],
    "hidden": {"*": [TRIAL | {"clothing": SHOT, "logo": SHOT}]},
    "cloaks": [{"part": NAME, "front?": FILE, "back?": FILE}],
}
"""What pictures.json says."""


# --- its folder


@dataclass(frozen=True)
class Entry:
    """All that joins of a card's folder."""

    card: dict
    rows: dict[str, list[Results]]
    """By part, a table for each repetition."""
    pictures: dict
    images: dict[str, Image.Image]
    """By path in the card's folder."""

    @property
    def name(self) -> str:
        """The folder's name: the detector's, and a hash of the figures and of the rows."""
        tables = [table for results in self.rows.values() for one in results for table in (one.images, one.boxes)]
        rows = sha256_arrays(*(table["score"].to_numpy() for table in tables))
        return f"{file_name(self.card['spec'])[:60]}-{sha256_record([self.card, rows])[:12]}"


def read_told(folder: Path) -> tuple[dict, dict, Size]:
    """Read what a card says, what of it only itself can say (`CARD`), and its size. InputError: see there."""
    path = _plain(folder, "card.json", most=MAX_JSON_BYTES)
    content = read_card(path)
    # null is as good as a missing value
    stated = check_shape({key: value for key, value in content.items() if value is not None}, CARD, str(path))
    if stated["size"] not in SIZES:
        raise InputError(f"{path}: size is {stated['size']!r}, none of {', '.join(SIZES)}")
    if list(stated["materials"]["detectors"]) != [stated["spec"]]:
        raise InputError(f"{path}: materials.detectors has no digest of {stated['spec']}")
    size = SIZES[stated["size"]]
    _hold(path, fixed(size), {key: content.get(key) for key in fixed(size)})
    return content, stated, size


def read_entry(folder: Path) -> Entry:
    """Read a card's folder, and compute its figures again from its rows.

    InputError: names the file and the place of the first thing that does not hold.
    """
    content, stated, size = read_told(folder)
    path, parts = folder / "card.json", parts_of(stated, size)
    files = {name for part in parts for name in part.files}
    for name in sorted(files):
        _plain(folder, ROWS, name, most=MAX_ROWS)
    for other in sorted((folder / ROWS).glob("*.npz")):
        if other.name not in files:
            raise InputError(f"{other}: of no part of the card")
    try:
        rows = {part.name: [_read_rows(folder, name, part, stated, size) for name in part.files] for part in parts}
        card = card_of(stated, size, rows)
        _hold(path, card, content)
        pictures, images = _read_pictures(folder, rows, size)
    except InputError:
        raise
    except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
        raise InputError(f"{path}: not the figures of a card ({type(error).__name__}: {error})") from None
    return Entry(card, rows, pictures, images)


def _hold(path: Path, fresh: dict, stated: dict) -> None:
    wrong = next(differences(fresh, stated), None)
    if wrong is not None:
        raise InputError(f"{path}: {wrong}")


def _plain(folder: Path, *names: str, most: int) -> Path:
    """Name a file in a folder that is no link, in no linked folder, and not longer than `most` bytes (InputError)."""
    path = folder
    for name in names:
        path /= name
        if path.is_symlink():
            raise InputError(f"{path}: a link; a card's folder holds its files themselves")
    if path.is_file() and path.stat().st_size > most:
        raise InputError(f"{path}: larger than any of its kind taken here")
    return path


def _read_rows(folder: Path, name: str, part: Part, stated: Mapping, size: Size) -> Results:
    """Read one repetition's rows, which have to be of the protocol's images and of this card's detector."""
    path = folder / ROWS / name
    results = read_results(path)
    images, count = results.images, len(results.background_names)
    asked = _asked_of_people(stated, results, size) if part.name == "people" else _asked_of_part(part, stated, results)
    columns = (*COLUMNS, *TRUE_BOX, *(("photograph", "seen_from") if part.name == "people" else ()))
    asked |= {
        "columns": (set(results.trials), set(columns)),
        "detector": (results.detectors, (stated["spec"],)),
        "operating point": (set(images["operating_point"]), {stated["operating_point"]}),
        "number of backgrounds": (count, stated["materials"]["unseen_backgrounds"]["count"]),
        "scores from 0 to 1": (bool(images["score"].between(0, 1).all()), True),
    }
    for what, (actual, expected) in asked.items():
        if actual != expected:
            raise InputError(f"{path}: {what}: {actual!r:.60}; this card and its size ask for {expected!r:.60}")
    return results


def _asked_of_part(part: Part, stated: Mapping, results: Results) -> dict[str, tuple[object, object]]:
    """Compare the rows of rendered bodies, what there is and what is asked for: the same images in the same order."""

    def numbers(trials: pd.DataFrame) -> list:
        return np.nan_to_num(trials[list(COLUMNS)].to_numpy(np.float64), nan=-1).tolist()

    count, images, unseen = len(results.background_names), results.images, stated["materials"]["unseen"]
    controls, trials = part.drawn(unseen, count)
    bare = images.loc[(images["control"] == NOBODY).to_numpy(), "background"]
    return {
        "bodies": (list(results.body_names), unseen["poses"]),
        "controls": (results.controls, controls),
        "images": (numbers(results.trials), numbers(trials)),
        "bare scenes": (bare.tolist(), bare_backgrounds(count, EvaluateSettings(**part.settings)).tolist()),
    }


def _asked_of_people(stated: Mapping, results: Results, size: Size) -> dict[str, tuple[object, object]]:
    """Compare the rows of people in photographs: each of them once, in the cloaks and patterns of the card."""
    people, rendered = stated["materials"]["shown_people"]["count"], [row["name"] for row in stated["patterns"]]
    left_out = sum(stated["photographs"]["left_out"].get(reason, 0) for reason in (UNFIT, UNCOVERED))
    worn = results.controls[: -len(UNTRAINED)]
    return {
        "people": (results.trials["pose"].tolist(), list(range(people - left_out))),
        "controls": (results.controls[len(worn) :], UNTRAINED),
        "cloak made against it": (worn.count(AGAINST), int(stated["differentiable"])),
        "heads": ([name for name in worn if name in (*HEADS, GREY_HEAD)], [*HEADS, GREY_HEAD]),
        "patterns": ([name for name in worn if name in rendered], rendered),
        "size": (len(results.trials) <= size.people and sum("@" in name for name in worn) <= size.patterns, True),
    }


def _read_pictures(folder: Path, rows: dict[str, list[Results]], size: Size) -> tuple[dict, dict[str, Image.Image]]:
    """Read pictures.json and the pictures that it names; what a picture shows has to be what the rows say."""
    path = _plain(folder, "pictures.json", most=MAX_JSON_BYTES)
    stated, images = check_shape(read_json(path), PICTURES, str(path)), {}
    for part, shown, files, most in _listed(stated, size):
        if "trial" in shown:
            _hold(path, describe(pool(rows[part]), shown["trial"]), {key: shown[key] for key in DESCRIBED})
        for name in files:
            place = ("pictures", place_of(part), name)
            with open_picture(_plain(folder, *place, most=MAX_PICTURE)) as picture:
                if max(picture.size) > most or part not in rows:
                    raise InputError(f"{Path(*place)}: larger than the card's pictures, or of no part of it")
                images["/".join(place)] = picture.convert("RGB" if name.endswith(".jpg") else "RGBA")
    return stated, images


def _listed(stated: dict, size: Size) -> Iterator[tuple[str, dict, list[str], int]]:
    """List what pictures.json shows: part, what is said of it, files, and their largest side in pixels."""
    shots = [("clean", shown) for kind in ("missed", "alarms") for shown in stated[kind]]
    shots += [(part, shown) for part, pairs in stated["hidden"].items() for shown in pairs]
    for part, shown in shots:
        yield part, shown, [shown[key]["file"] for key in ("clothing", "logo", "bare") if key in shown], size.pixels
    for shown in stated["cloaks"]:
        yield shown["part"], shown, [shown[side] for side in SIDES if side in shown], FLAT


def write_entry(entry: Entry, board: Path) -> Path:
    """Write a card into its own folder of a leaderboard, at one rename; one that is there is left as it is."""
    target = board / entry.name
    if target.exists():
        return target
    with new_folder(target) as folder:
        write_json(folder / "card.json", entry.card)
        write_json(folder / "pictures.json", entry.pictures)
        for part in parts_of(entry.card, SIZES[entry.card["size"]]):
            keep_rows(folder, part, entry.rows[part.name])
        for place, image in entry.images.items():
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
            save_picture(folder / place, image, **(SAVING if place.endswith(".jpg") else {"optimize": True}))
    return target


def remove_card(folder: Path) -> None:
    """Remove a card's folder; where it holds anything else, or a link, remove card.json alone."""

    def is_listed(path: Path) -> bool:
        place = path.relative_to(folder).as_posix()
        return not path.is_symlink() and any(fnmatch.fnmatchcase(place, pattern) for pattern in LISTED)

    if all(is_listed(path) for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()):
        shutil.rmtree(folder)
    else:
        (folder / "card.json").unlink()
