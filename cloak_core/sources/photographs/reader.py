"""Reads the photographs of a COCO file: each is opened only if somebody in it can be dressed.

What a photograph is (the hash of its pixels, its look, who its people are) is kept on disk by the hash of its file, so
that the next command decodes nothing before it draws somebody.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloak_core.core.pictures import MAX_FILE_BYTES
from cloak_core.files.caching import DiskCache, cache_folder
from cloak_core.files.errors import InputError
from cloak_core.files.identity import code_hash, package_versions, sha256_arrays, sha256_record
from cloak_core.files.likeness import picture_look
from cloak_core.files.reading import parse_json, read_bytes
from cloak_core.sources.photographs.annotations import description
from cloak_core.sources.photographs.choosing import Dressable, choose
from cloak_core.sources.photographs.crops import (
    FileCrop,
    HeldCrop,
    cut,
    cut_mask,
    file_stamp,
    pack_mask,
    upright_picture,
)
from cloak_core.sources.photographs.person import Person

SURROUNDINGS = 2.4
"""Side of a person's crop, in heights of her box: as much as any view of her shows."""
MOST_HEIGHT = 420
"""Pixels; taller people are resized to it, more is seen by no detector here."""
IDENTITIES_BYTES = 256 << 20
AHEAD = 32
"""Photographs that are read beyond the one whose people are wanted next."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A photograph as a COCO file lists it."""

    image: dict
    annotations: list[dict]
    licence: str


class Reader:
    """Reads the people of one photograph after the other.

    The same pixels under another name are the same photograph, called as it was first.
    """

    def __init__(self, path: str, folders: Sequence[Path]) -> None:
        """path: of the COCO file, for messages; folders: where its photographs are looked for."""
        self._path, self._folders = path, folders
        self._names: dict[str, str] = {}
        self._listed: set[tuple[str, str]] = set()
        self._known = DiskCache(cache_folder("photographs"), ".json", IDENTITIES_BYTES, "identities of photographs")
        decoder = code_hash("sources/photographs/crops.py", "sources/photographs/person.py", "files/likeness.py")
        self._decoder = [decoder, package_versions("pillow")]

    def people(self, entries: Iterable[Entry]) -> Iterator[tuple[str, Person | str]]:
        """Yield what each annotation is called, with its person, or the reason why she is left out."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        with ThreadPoolExecutor(cores, "photographs") as pool:
            read: deque = deque()
            try:
                for entry in entries:
                    chosen, left_out = self._choose(entry)
                    read.append((left_out, pool.submit(self._read, entry, chosen) if chosen else None))
                    if len(read) > AHEAD:
                        yield from self._counted(*read.popleft())
                while read:
                    yield from self._counted(*read.popleft())
            finally:
                pool.shutdown(cancel_futures=True)

    def _counted(self, left_out: list, future: object) -> Iterator[tuple[str, Person | str]]:
        """Yield what is left out and the people, each once, whatever her photograph is called."""
        yield from left_out
        for what, text, person in () if future is None else future.result():
            content = (person.pixels, text)
            photograph = self._names.setdefault(person.pixels, person.photograph)
            yield what, "listed twice" if content in self._listed else person.called(photograph)
            self._listed.add(content)

    def _choose(self, entry: Entry) -> tuple[list[tuple[Dressable, str]], list[tuple[str, str]]]:
        """Choose who can be dressed, each with what the file says of her; the photograph is opened for its size alone,
        where the file does not tell it."""
        if not entry.annotations:
            return [], []
        name = entry.image.get("file_name")
        if not isinstance(name, str) or not name:
            raise InputError(f"{self._path}: image {entry.image.get('id')} has no file_name")
        listed: dict[str, dict] = {}
        twice: list[tuple[str, str]] = []
        for annotation in entry.annotations:
            what = self._called(annotation, name)
            if listed.setdefault(description(annotation), annotation) is not annotation:
                twice.append((what, "listed twice"))
        size = entry.image.get("width"), entry.image.get("height")
        if None in size:
            picture, _ = upright_picture(self._place(entry))
            size = picture.shape[1], picture.shape[0]
        names = {self._called(annotation, name): text for text, annotation in listed.items()}
        chosen, left_out = choose(list(listed.values()), (int(size[0]), int(size[1])), list(names))
        return [(somebody, names[somebody.what]) for somebody in chosen], twice + left_out

    def _called(self, annotation: dict, name: str) -> str:
        return f"{self._path}: annotation {annotation['id']} ({name})"

    def _place(self, entry: Entry) -> Path:
        """Find the photograph's file. InputError: it leads out of the folders, or is not there."""
        name = entry.image["file_name"]
        what = self._what(entry)
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise InputError(f"{what}: the file name leads out of the photographs' folder")
        place = next((folder / name for folder in self._folders if (folder / name).is_file()), None)
        if place is None:
            raise InputError(f"{what}: no such photograph in {' or '.join(map(str, self._folders))} (--images DIR)")
        return place

    def _what(self, entry: Entry) -> str:
        return f"{self._path}: image {entry.image.get('id')} ({entry.image['file_name']})"

    def _read(self, entry: Entry, chosen: list[tuple[Dressable, str]]) -> list[tuple[str, str, Person]]:
        """Read a photograph's people: what each is called, what the file says of her, and herself."""
        path = self._place(entry)
        stamp = file_stamp(path)
        data = read_bytes(path, MAX_FILE_BYTES)
        people = [_cropped(somebody, path, stamp) for somebody, _ in chosen]
        parts = [hashlib.sha256(data).hexdigest(), [_content(person) for person in people], self._decoder]
        name = sha256_record(parts)
        kept = self._known.get(name)
        if kept is None:
            picture, turned = upright_picture(path, data)
            record = _identified(picture, people) | {"turned": turned}
            self._known.put(name, json.dumps(record).encode())
        else:
            record = parse_json(kept.tobytes(), "cached identities")
        _check_size(entry.image, record, self._what(entry))
        known = {"photograph": entry.image["file_name"], "licence": entry.licence}
        known |= {"pixels": record["pixels"], "look": record["look"]}
        return [
            (somebody.what, text, person.known_as(identity, **known))
            for (somebody, text), person, identity in zip(chosen, people, record["identities"], strict=True)
        ]


def _identified(picture: np.ndarray, people: Sequence[Person]) -> dict:
    """Record what a photograph is, and who its people are."""
    identities = []
    for person in people:
        crop: FileCrop = person.crop
        held = HeldCrop(cut(picture, crop.region, crop.shape), crop.mask)
        identities.append(person.in_crop(held).identity)
    size = [picture.shape[1], picture.shape[0]]
    return {"pixels": sha256_arrays(picture), "look": picture_look(picture), "size": size, "identities": identities}


def _content(person: Person) -> str:
    """Hash all of a person but her pixels."""
    crop: FileCrop = person.crop
    landmarks = person.landmarks
    depth = np.zeros(0) if landmarks.depth is None else landmarks.depth
    numbers = [np.array(crop.region), np.array(crop.shape), np.array([person.box, *person.others], np.float64)]
    return sha256_arrays(np.frombuffer(crop.packed, np.uint8), *numbers, landmarks.xy, landmarks.visibility, depth)


def _check_size(image: dict, record: dict, what: str) -> None:
    """Check that a photograph has the size that the file tells. InputError: it has another."""
    width, height = record["size"]
    listed = (image.get("width", width), image.get("height", height))
    if listed == (width, height):
        return
    is_turned = record["turned"] and listed == (height, width)
    hint = " (its EXIF record turns it: annotate the upright picture)" if is_turned else ""
    raise InputError(f"{what}: {width} x {height} pixels, annotated as {listed[0]} x {listed[1]}{hint}")


def _cropped(somebody: Dressable, path: Path, stamp: tuple[int, int]) -> Person:
    """The person with as much of the photograph as `SURROUNDINGS` says, resized where she is larger than needed."""
    x0, y0, x1, y1 = somebody.box
    half = SURROUNDINGS * max(y1 - y0, x1 - x0) / 2
    height, width = somebody.mask.shape
    left, top = max(0, int((x0 + x1) / 2 - half)), max(0, int((y0 + y1) / 2 - half))
    right, bottom = min(width, int((x0 + x1) / 2 + half) + 1), min(height, int((y0 + y1) / 2 + half) + 1)
    shape = bottom - top, right - left
    scale = min(1.0, MOST_HEIGHT / (y1 - y0))
    if scale < 1:
        shape = round(shape[0] * scale), round(shape[1] * scale)
    region = (left, top, right, bottom)
    move = lambda box: tuple(float(scale * (v - o)) for v, o in zip(box, (left, top) * 2, strict=True))
    return Person(
        "",
        somebody.number,
        FileCrop(path, stamp, region, shape, pack_mask(cut_mask(somebody.mask, region, shape))),
        move(somebody.box),
        somebody.landmarks.moved((float(left), float(top)), scale),
        tuple(move(box) for box in somebody.others),
    )
