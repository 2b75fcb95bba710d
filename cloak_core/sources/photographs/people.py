"""People in photographs, as a file in COCO's format describes them.

Each person that can be dressed becomes a crop of the photograph with a mask and landmarks; the others are counted by
the reason why not.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8

from cloak_core.core.pictures import open_picture
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.reading import read_json
from cloak_core.sources.bodies.selection import select, split_selection
from cloak_core.sources.photographs.landmarks import INDEX, LIMBS, SEEN, Landmarks, is_upright, read_landmarks
from cloak_core.sources.photographs.masks import decode_mask, numbers

SURROUNDINGS = 2.4
"""Side of a person's crop, in heights of her box: as much as any view of her shows."""
MOST_HEIGHT = 420
"""Pixels; taller people are resized to it, more is seen by no detector here."""
LEAST_HEIGHT = 96
Box = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Person:
    """One person who can be dressed: a crop of a photograph with her mask, box and landmarks in its pixels."""

    photograph: str
    """File name."""
    number: int
    """The annotation's id."""
    image: UInt8[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"]
    box: Box
    """x0, y0, x1, y1 in pixels of the crop."""
    landmarks: Landmarks
    others: tuple[Box, ...] = ()
    """Boxes of the other annotated people."""
    licence: str = ""

    @property
    def name(self) -> str:
        """PHOTOGRAPH#ID."""
        return f"{self.photograph}#{self.number}"

    @property
    def identity(self) -> str:
        """SHA-256 of the pixels, the mask and the landmarks."""
        return sha256_arrays(self.image, self.mask, self.landmarks.xy)


@dataclass(frozen=True, eq=False)
class People:
    """The people of a file who can be dressed, and why the others cannot."""

    people: tuple[Person, ...]
    """In the order of the file."""
    left_out: dict[str, int]
    """Reason -> how many: "crowd", "no landmarks", "no mask", "hidden", "cut", "small", "not upright", "sitting"."""
    name: str = "people"
    """What a run's record calls them."""

    def __len__(self) -> int:
        return len(self.people)

    @property
    def photographs(self) -> tuple[str, ...]:
        """File names, in order, each once."""
        return tuple(dict.fromkeys(person.photograph for person in self.people))

    def halves(self) -> tuple[People, People]:
        """The people of every second photograph, and those of the others. `InputError`: there is only one."""
        names = self.photographs
        if len(names) < 2:
            raise InputError(f"{self.name}: one photograph cannot be both trained on and unseen")
        part = lambda start: tuple(person for person in self.people if person.photograph in names[start::2])
        return replace(self, people=part(0)), replace(self, people=part(1))


def load_people(spec: str | os.PathLike, images: str | os.PathLike | None = None) -> People:
    """Read people in photographs from a COCO file: PEOPLE.json, or PEOPLE.json[0::2] for every second photograph.

    images: the photographs' folder; None: the file's own, or `images` in it. A selection counts or names photographs
    (see `scene.selection`). `InputError` names annotation and file for whatever is broken or does not fit the picture.
    """
    path, selection = split_selection(str(spec))
    record = read_json(path)
    folders = [Path(images)] if images is not None else [Path(path).parent, Path(path).parent / "images"]
    listed = _table(record, "images", path)
    if selection is not None:
        names = [str(entry.get("file_name")) for entry in listed]
        listed = [listed[i] for i in select(selection, names, str(spec))]
    licences = {entry.get("id"): str(entry.get("name")) for entry in record.get("licenses") or []}
    of_image: dict[object, list[dict]] = {}
    for annotation in _table(record, "annotations", path):
        of_image.setdefault(annotation.get("image_id"), []).append(annotation)
    found: list[Person] = []
    left_out: Counter[str] = Counter()
    disordered: list[str] = []
    for entry in listed:
        annotations = of_image.get(entry.get("id"), [])
        licence = licences.get(entry.get("license"), "")
        for what, person in _annotated(entry, annotations, folders, licence, path):
            if isinstance(person, Person):
                found.append(person)
            else:
                left_out[person] += 1
                disordered += [what] * (person == "not upright")
    if len(disordered) > len(found):  # few people stand on their heads
        raise InputError(
            f"{disordered[0]}: keypoints of another order? shoulders, hips, knees and ankles do not follow each other "
            f"downwards, in {len(disordered)} of {len(disordered) + len(found)} people"
        )
    if not found:
        reasons = ", ".join(f"{reason} {count}" for reason, count in left_out.items()) or "no annotation"
        raise InputError(f"{spec}: nobody in it can be dressed ({reasons})")
    return People(tuple(found), dict(left_out), Path(path).stem)


def _table(record: dict, name: str, path: str) -> list[dict]:
    table = record.get(name)
    if not isinstance(table, list) or not all(isinstance(entry, dict) for entry in table):
        raise InputError(f"{path}: no list '{name}' of objects in it: not a file in COCO's format")
    return table


def _annotated(
    entry: dict, annotations: list[dict], folders: list[Path], licence: str, path: str
) -> Iterator[tuple[str, Person | str]]:
    """Yield what each annotation of a photograph is called, with its person, or the reason why she is left out."""
    if not annotations:
        return
    name = entry.get("file_name")
    if not isinstance(name, str) or not name:
        raise InputError(f"{path}: image {entry.get('id')} has no file_name")
    image = _read_upright(name, entry, folders, f"{path}: image {entry.get('id')} ({name})")
    height, width = image.shape[:2]
    whats = [f"{path}: annotation {a.get('id')} ({name})" for a in annotations]
    boxes = [_box(a, width, height, what) for a, what in zip(annotations, whats, strict=True)]
    for number, (annotation, what) in enumerate(zip(annotations, whats, strict=True)):
        box = boxes[number]
        # Everything given is checked, also of those who are then left out.
        mask = None
        if annotation.get("segmentation"):
            mask = decode_mask(annotation["segmentation"], height, width, what)
        landmarks = read_landmarks(annotation, what)
        reason = why_left_out(annotation, mask, landmarks, box, (width, height))
        if reason:
            yield what, reason
            continue
        others = tuple(b for i, b in enumerate(boxes) if i != number and not annotations[i].get("iscrowd"))
        whole = Person(name, int(annotation.get("id") or 0), image, mask, box, landmarks, others)
        yield what, _cropped(whole, licence)


def _read_upright(name: str, entry: dict, folders: list[Path], what: str) -> UInt8[np.ndarray, "h w 3"]:
    from PIL import ImageOps

    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(f"{what}: the file name leads out of the photographs' folder")
    place = next((folder / name for folder in folders if (folder / name).is_file()), None)
    if place is None:
        raise InputError(f"{what}: no such photograph in {' or '.join(map(str, folders))} (--images DIR)")
    with open_picture(place) as picture:
        upright = ImageOps.exif_transpose(picture).convert("RGB")
        turned = upright.size != picture.size
        image = np.array(upright)
    given = (entry.get("width", upright.width), entry.get("height", upright.height))
    if given != upright.size:
        hint = (
            " (its EXIF record turns it: annotate the upright picture)"
            if turned and given == upright.size[::-1]
            else ""
        )
        raise InputError(
            f"{what}: {upright.width} x {upright.height} pixels, annotated as {given[0]} x {given[1]}{hint}"
        )
    return image


def _box(annotation: dict, width: int, height: int, what: str) -> Box:
    values = numbers(annotation.get("bbox"), f"{what}: bbox")
    if values.shape != (4,) or values[2:].min() < 0:
        raise InputError(f"{what}: bbox is not x, y, width, height")
    x, y, w, h = values.tolist()
    if x < -2 or y < -2 or x + w > width + 2 or y + h > height + 2:
        raise InputError(f"{what}: bbox lies outside the photograph ({width} x {height})")
    return x, y, x + w, y + h


def why_left_out(
    annotation: dict, mask: np.ndarray | None, landmarks: Landmarks | None, box: Box, size: tuple[int, int]
) -> str:
    """Say why a person cannot be dressed; "" where she can."""
    if annotation.get("iscrowd"):
        return "crowd"
    if mask is None or not mask.any():
        return "no mask"
    if landmarks is None:
        return "no landmarks"
    if box[3] - box[1] < LEAST_HEIGHT:
        return "small"
    if (landmarks.visibility[list(LIMBS[:6])] < SEEN).any():
        return "hidden"
    xy = landmarks.xy[list(LIMBS)]
    if (
        (xy.min(axis=0) < -8).any()
        or (xy.max(axis=0) > np.add(size, 8)).any()
        or (landmarks.visibility[list(LIMBS[6:])] < SEEN).any()
    ):
        return "cut"
    if box[0] < 1 or box[2] > size[0] - 1:
        return "cut"
    if not is_upright(landmarks, box[3] - box[1]):
        return "not upright"
    at = np.clip(np.rint(xy).astype(int), 0, np.subtract(size, 1))
    if mask[at[:, 1], at[:, 0]].mean() < 0.7:
        return "hidden"
    return "sitting" if _sits(landmarks) else ""


def _sits(landmarks: Landmarks) -> bool:
    """Both thighs far from hanging down, as long as the trunk leads one to expect them."""
    at = lambda joint: landmarks.xy[[INDEX[f"l_{joint}"], INDEX[f"r_{joint}"]]]
    trunk = abs(at("hip").mean(axis=0)[1] - at("shoulder").mean(axis=0)[1])
    drop = (at("knee") - at("hip"))[:, 1]
    return bool((drop < 0.54 * trunk).all())


def _cropped(person: Person, licence: str) -> Person:
    """The person with as much of the photograph as `SURROUNDINGS` says, resized where she is larger than needed."""
    from PIL import Image

    x0, y0, x1, y1 = person.box
    half = SURROUNDINGS * max(y1 - y0, x1 - x0) / 2
    height, width = person.mask.shape
    left, top = max(0, int((x0 + x1) / 2 - half)), max(0, int((y0 + y1) / 2 - half))
    right, bottom = min(width, int((x0 + x1) / 2 + half) + 1), min(height, int((y0 + y1) / 2 + half) + 1)
    image, mask = person.image[top:bottom, left:right], person.mask[top:bottom, left:right]
    scale = min(1.0, MOST_HEIGHT / (y1 - y0))
    if scale < 1:
        size = round(image.shape[1] * scale), round(image.shape[0] * scale)
        image = np.array(Image.fromarray(image).resize(size, Image.Resampling.LANCZOS))
        mask = np.array(Image.fromarray(mask).resize(size, Image.Resampling.BILINEAR))
    move = lambda box: tuple(float(scale * (v - o)) for v, o in zip(box, (left, top) * 2, strict=True))
    landmarks = person.landmarks.moved((float(left), float(top)), scale)
    return Person(
        person.photograph,
        person.number,
        np.ascontiguousarray(image),
        np.ascontiguousarray(mask),
        move(person.box),
        landmarks,
        tuple(move(box) for box in person.others),
        licence,
    )
