"""Read a file in COCO's format: every field that is used has its type and bounds, or is named with its annotation."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from cloak_core.files.errors import InputError
from cloak_core.files.reading import is_number, read_json
from cloak_core.sources.photographs.landmarks import SEEN, Landmarks
from cloak_core.sources.photographs.masks import MAX_SIDE

MAX_NAME_BYTES = 255
"""Of a file's name, on every usual file system."""
MAX_TEXT = 1000
MISPLACED = 0.7
"""Larger sides of a box by which landmarks may lie outside of it: the crop around her reaches 0.7 beyond every edge."""
Check = Callable[[object], str]
"""What a value has to be, where it is not; "" where it is."""


def read_coco(path: str | os.PathLike) -> dict:
    """Read a COCO file whose tables "images", "annotations", "categories" and "licenses" hold what the format says.

    Returns the record as it stands in the file. Whole numbers may be written as 3.0. InputError names the annotation
    or image, and the field: an id that is text, a list or NaN, a licence that is an object, a name longer than a file
    may have.
    """
    record = read_json(path)
    for name, fields in TABLES.items():
        table = record.get(name)
        if table is None and name not in REQUIRED:
            continue
        if not isinstance(table, list) or not all(isinstance(entry, dict) for entry in table):
            raise InputError(f"{path}: no list '{name}' of objects in it: not a file in COCO's format")
        for number, entry in enumerate(table):
            _check(entry, fields, f"{path}: {_called(name, number, entry)}")
    return record


def check_place(box: tuple[float, float, float, float], landmarks: Landmarks, what: str) -> None:
    """Check that a box (x0, y0, x1, y1) holds its landmarks. InputError: most seen ones lie far from it.

    That is so where rows of two files were mixed up: nothing of the body would lie in the crop around the box.
    """
    seen = landmarks.xy[landmarks.visibility >= SEEN]
    low, high = np.array(box[:2]), np.array(box[2:])
    margin = MISPLACED * (high - low).max()
    inside = ((seen >= low - margin) & (seen <= high + margin)).all(axis=1)
    if len(seen) and inside.mean() < 0.5:
        x, y = np.median(seen, axis=0)
        raise InputError(f"{what}: bbox lies elsewhere than its landmarks, which are around {x:.0f}, {y:.0f}")


def _check(entry: dict, fields: dict[str, Check], what: str) -> None:
    for field, check in fields.items():
        value = entry.get(field)
        if value is not None and (words := check(value)):
            raise InputError(f"{what}: {field} {_shown(value)} is not {words}")


def _called(table: str, number: int, entry: dict) -> str:
    """Name an entry by its id, or by its place where it has none to name."""
    kind = {"images": "image", "annotations": "annotation", "categories": "category", "licenses": "licence"}[table]
    given = entry.get("id")
    return f"{kind} {given}" if isinstance(given, int | str) and len(str(given)) < 100 else f"{kind} number {number}"


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


def _whole(value: object) -> str:
    fits = is_number(value) and float(value).is_integer()
    return "" if fits else "a whole number"


def _whole_or_text(value: object) -> str:
    """An image's id is a key alone: tools write names there."""
    fits = isinstance(value, str) and 0 < len(value) <= MAX_TEXT
    return "" if fits or not _whole(value) else "a whole number or text"


def _text(value: object) -> str:
    return "" if isinstance(value, str) and len(value) <= MAX_TEXT else f"text of at most {MAX_TEXT} characters"


def _file_name(value: object) -> str:
    fits = isinstance(value, str) and value and "\0" not in value
    if fits and max(len(part.encode("utf-8", "replace")) for part in value.split("/")) <= MAX_NAME_BYTES:
        return ""
    return f"a file's name, of at most {MAX_NAME_BYTES} bytes"


def _side(value: object) -> str:
    fits = not _whole(value) and 1 <= value <= MAX_SIDE
    return "" if fits else f"a number of pixels, 1 to {MAX_SIDE}"


def _flag(value: object) -> str:
    return "" if value in (0, 1) and isinstance(value, int) else "0 or 1"


TABLES: dict[str, dict[str, Check]] = {
    "licenses": {"id": _whole_or_text, "name": _text},
    "categories": {"id": _whole, "name": _text},
    "images": {
        "id": _whole_or_text,
        "file_name": _file_name,
        "width": _side,
        "height": _side,
        "license": _whole_or_text,
    },
    "annotations": {"id": _whole, "image_id": _whole_or_text, "category_id": _whole, "iscrowd": _flag},
}
"""Table -> field -> its check; what is not here is not used, or is checked where the picture is known."""
REQUIRED = ("images", "annotations")
