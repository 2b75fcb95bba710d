"""A file in COCO's format: every field that is used has its type and bounds, or is named with its annotation."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable

from cloak_core.files.errors import InputError
from cloak_core.files.reading import is_number, read_json
from cloak_core.sources.photographs.annotation import MAX_SIDE

MAX_COCO_BYTES = 1 << 29
"""COCO's own keypoints of train2017 are half of it, with 262,465 annotations."""
MAX_COCO_VALUES = 1 << 26
MAX_NAME_BYTES = 255
"""Of a file's name, on every usual file system."""
MAX_TEXT = 1000
PERSON_NAMES = ("person", "people", "pedestrian", "human")
"""Categories of people; annotations of every other category are nobody."""
DESCRIPTION = ("bbox", "segmentation", "keypoints", "blazepose", "iscrowd")
"""What an annotation says of a person; two of one photograph that agree in it are the same person."""


def _is_whole(value: object) -> bool:
    return is_number(value) and float(value).is_integer()


def _is_text(value: object) -> bool:
    return isinstance(value, str) and len(value) <= MAX_TEXT


def _is_file_name(value: object) -> bool:
    if not isinstance(value, str) or not value or "\0" in value:
        return False
    return max(len(part.encode("utf-8", "replace")) for part in value.split("/")) <= MAX_NAME_BYTES


Check = tuple[Callable[[object], bool], str]
"""Whether a value is what a field may hold, and what that is in words."""
WHOLE: Check = (_is_whole, "a whole number")
KEY: Check = (lambda value: _is_whole(value) or (_is_text(value) and value != ""), "a whole number or text")
"""What an image's id may be: a key alone, tools write names there."""
TEXT: Check = (_is_text, f"text of at most {MAX_TEXT} characters")
FILE_NAME: Check = (_is_file_name, f"a file's name, of at most {MAX_NAME_BYTES} bytes")
SIDE: Check = (lambda value: _is_whole(value) and 1 <= value <= MAX_SIDE, f"a number of pixels, 1 to {MAX_SIDE}")
FLAG: Check = (lambda value: isinstance(value, int) and value in (0, 1), "0 or 1")
TABLES: dict[str, tuple[str, dict[str, Check]]] = {
    "licenses": ("licence", {"id": KEY, "name": TEXT}),
    "categories": ("category", {"id": WHOLE, "name": TEXT}),
    "images": ("image", {"id": KEY, "file_name": FILE_NAME, "width": SIDE, "height": SIDE, "license": KEY}),
    "annotations": ("annotation", {"id": WHOLE, "image_id": KEY, "category_id": WHOLE, "iscrowd": FLAG}),
}
"""Table -> what an entry is called, and field -> its check; other fields are not used, or checked with the picture."""
REQUIRED = ("images", "annotations")


def read_coco(path: str | os.PathLike) -> dict:
    """Read a COCO file whose tables "images", "annotations", "categories" and "licenses" hold what the format says.

    Returns the record as it stands in the file. Whole numbers may be written as 3.0. InputError names the annotation
    or image, and the field: an id that is text, a list or NaN, a licence that is an object, a name longer than a file
    may have; one id of two images.
    """
    record = read_json(path, MAX_COCO_BYTES, MAX_COCO_VALUES)
    for name, (kind, fields) in TABLES.items():
        table = record.get(name)
        if table is None and name not in REQUIRED:
            continue
        if not isinstance(table, list) or not all(isinstance(entry, dict) for entry in table):
            raise InputError(f"{path}: no list '{name}' of objects in it: not a file in COCO's format")
        for number, entry in enumerate(table):
            _check_fields(entry, fields, path, kind, number)
    names: dict[str, object] = {}
    for entry in record["images"]:
        number, name = entry.get("id"), entry.get("file_name")
        if names.setdefault(repr(number), name) != name:
            raise InputError(f"{path}: image {number}: stands for both {names[repr(number)]} and {name}")
    return record


def _check_fields(entry: dict, fields: dict[str, Check], path: str | os.PathLike, kind: str, number: int) -> None:
    for field, (is_right, words) in fields.items():
        value = entry.get(field)
        if value is None or is_right(value):
            continue
        own = entry.get("id")
        has_name = isinstance(own, int | str) and len(str(own)) < 100
        what = f"{kind} {own}" if has_name else f"{kind} number {number}"
        text = repr(value)
        shown = text if len(text) <= 40 else f"{text[:40]}..."
        raise InputError(f"{path}: {what}: {field} {shown} is not {words}")


def people_by_image(record: dict, path: str) -> dict[str, list[dict]]:
    """List the annotations of people by `repr` of their image's id; in a file without categories, all are people.

    Each has an id, a whole number: its place in the file where it had none. `InputError`: no category of people, a
    category that the file does not have, an id of two different annotations.
    """
    categories = record.get("categories") or []
    is_person = {repr(entry.get("id")): str(entry.get("name")).strip().lower() in PERSON_NAMES for entry in categories}
    if categories and not any(is_person.values()):
        raise InputError(f"{path}: categories: none is called {', '.join(PERSON_NAMES)}")
    by_image: dict[str, list[dict]] = {}
    by_id: dict[int, bytes] = {}
    for place, annotation in enumerate(record["annotations"], 1):
        own = annotation.get("id")
        number = place if own is None else int(own)
        category = annotation.get("category_id")
        if is_person and category is not None:
            if repr(category) not in is_person:
                raise InputError(f"{path}: annotation {number}: category {category} is none of the file's")
            if not is_person[repr(category)]:
                continue
        image = repr(annotation.get("image_id"))
        content = hashlib.blake2b(f"{image} {description(annotation)}".encode(), digest_size=16).digest()
        if by_id.setdefault(number, content) != content:
            raise InputError(f"{path}: annotation {number}: two different ones have this id")
        by_image.setdefault(image, []).append(annotation | {"id": number})
    return by_image


def description(annotation: dict) -> str:
    """Return what an annotation says of a person, as text to compare."""
    return json.dumps([annotation.get(key) for key in DESCRIPTION], sort_keys=True)
