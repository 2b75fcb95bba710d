"""Annotations of people in a COCO file: which of them are people, and which say the same twice."""

from __future__ import annotations

import hashlib
import json

from cloak_core.files.errors import InputError

PERSON_NAMES = ("person", "people", "pedestrian", "human")
"""Categories of people; annotations of every other category are nobody."""
DESCRIPTION = ("bbox", "segmentation", "keypoints", "blazepose", "iscrowd")
"""What an annotation says of a person; two of one photograph that agree in it are the same person."""


def table(record: dict, name: str, path: str) -> list[dict]:
    """Return a list of objects in a COCO file. `InputError`: there is none."""
    entries = record.get(name)
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(f"{path}: no list '{name}' of objects in it: not a file in COCO's format")
    return entries


def listed_images(record: dict, path: str) -> list[dict]:
    """Return the images. `InputError`: one id stands for two of them."""
    names: dict[str, object] = {}
    images = table(record, "images", path)
    for entry in images:
        number, name = entry.get("id"), entry.get("file_name")
        if names.setdefault(repr(number), name) != name:
            raise InputError(f"{path}: image {number}: stands for both {names[repr(number)]} and {name}")
    return images


def people_by_image(record: dict, path: str) -> dict[str, list[dict]]:
    """List the annotations of people by `repr` of their image's id; in a file without categories, all are people.

    Each has an id, a whole number: its place in the file where it had none. `InputError`: no category of people, a
    category that the file does not have, an id of two different annotations.
    """
    is_person = _person_categories(record, path)
    by_image: dict[str, list[dict]] = {}
    by_id: dict[int, bytes] = {}
    for place, annotation in enumerate(table(record, "annotations", path), 1):
        annotation = annotation | {"id": _number(annotation, place, path)}
        category = annotation.get("category_id")
        if is_person and category is not None:
            if repr(category) not in is_person:
                raise InputError(f"{path}: annotation {annotation['id']}: category {category} is none of the file's")
            if not is_person[repr(category)]:
                continue
        image = repr(annotation.get("image_id"))
        content = hashlib.blake2b(f"{image} {description(annotation)}".encode(), digest_size=16).digest()
        if by_id.setdefault(annotation["id"], content) != content:
            raise InputError(f"{path}: annotation {annotation['id']}: two different ones have this id")
        by_image.setdefault(image, []).append(annotation)
    return by_image


def description(annotation: dict) -> str:
    """Return what an annotation says of a person, as text to compare."""
    return json.dumps([annotation.get(key) for key in DESCRIPTION], sort_keys=True)


def _person_categories(record: dict, path: str) -> dict[str, bool]:
    """Tell by `repr` of its id whether a category is of people; empty where the file has no categories."""
    if not record.get("categories"):
        return {}
    categories = table(record, "categories", path)
    is_person = {repr(entry.get("id")): str(entry.get("name")).strip().lower() in PERSON_NAMES for entry in categories}
    if not any(is_person.values()):
        raise InputError(f"{path}: categories: none is called {', '.join(PERSON_NAMES)}")
    return is_person


def _number(annotation: dict, place: int, path: str) -> int:
    number = annotation.get("id")
    if number is None:
        return place
    try:
        return int(number)
    except (TypeError, ValueError):
        raise InputError(f"{path}: annotation {number!r}: its id is not a whole number") from None
