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
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloak_core.core.pictures import MAX_FILE_BYTES
from cloak_core.files.caching import DiskCache, cache_folder
from cloak_core.files.errors import InputError
from cloak_core.files.identity import code_hash, package_versions, sha256_arrays, sha256_record
from cloak_core.files.likeness import picture_look
from cloak_core.files.reading import parse_json, read_bytes
from cloak_core.sources.photographs.choosing import Dressable, choose
from cloak_core.sources.photographs.coco import description
from cloak_core.sources.photographs.person import Crop, Person, cut, file_stamp, pack_mask, upright_picture

SURROUNDINGS = 2.4
"""Side of a person's crop, in heights of her box: as much as any view of her shows."""
MOST_HEIGHT = 420
"""Pixels; taller people are resized to it, more is seen by no detector here."""
IDENTITIES_BYTES = 256 << 20
AHEAD = 32
"""Photographs that are read beyond the one whose people are wanted next."""
Reasons = list[tuple[str, str]]
"""What annotations are called, and why nobody is dressed by them."""


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
        self._decoder = [code_hash("sources/photographs/person.py", "files/likeness.py"), package_versions("pillow")]

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

    def _counted(self, left_out: Reasons, future: Future | None) -> Iterator[tuple[str, Person | str]]:
        """Yield what is left out and the people, each once, whatever her photograph is called."""
        yield from left_out
        for what, text, person in () if future is None else future.result():
            content = (person.pixels, text)
            photograph = self._names.setdefault(person.pixels, person.photograph)
            is_new = content not in self._listed
            yield what, person.known_as(person.identity, photograph=photograph) if is_new else "listed twice"
            self._listed.add(content)

    def _choose(self, entry: Entry) -> tuple[list[tuple[Dressable, str]], Reasons]:
        """Choose who can be dressed, each with what the file says of her; the photograph is opened for its size alone,
        where the file does not tell it."""
        if not entry.annotations:
            return [], []
        name = entry.image.get("file_name")
        if not name:
            raise InputError(f"{self._path}: image {entry.image.get('id')} has no file_name")
        listed: dict[str, tuple[str, dict]] = {}
        twice: Reasons = []
        for annotation in entry.annotations:
            what = f"{self._path}: annotation {annotation['id']} ({name})"
            if listed.setdefault(description(annotation), (what, annotation))[1] is not annotation:
                twice.append((what, "listed twice"))
        size = entry.image.get("width"), entry.image.get("height")
        if None in size:
            picture, _ = upright_picture(self._place(entry))
            size = picture.shape[1], picture.shape[0]
        names = {what: text for text, (what, _) in listed.items()}
        annotations = [annotation for _, annotation in listed.values()]
        chosen, left_out = choose(annotations, (int(size[0]), int(size[1])), list(names))
        return [(somebody, names[somebody.what]) for somebody in chosen], twice + left_out

    def _what(self, entry: Entry) -> str:
        return f"{self._path}: image {entry.image.get('id')} ({entry.image['file_name']})"

    def _place(self, entry: Entry) -> Path:
        """Find the photograph's file. InputError: it leads out of the folders, or is not there."""
        name = entry.image["file_name"]
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise InputError(f"{self._what(entry)}: the file name leads out of the photographs' folder")
        place = next((folder / name for folder in self._folders if (folder / name).is_file()), None)
        if place is None:
            folders = " or ".join(map(str, self._folders))
            raise InputError(f"{self._what(entry)}: no such photograph in {folders} (--images DIR)")
        return place

    def _read(self, entry: Entry, chosen: list[tuple[Dressable, str]]) -> list[tuple[str, str, Person]]:
        """Read a photograph's people: what each is called, what the file says of her, and herself.

        InputError: the photograph has another size than the file says.
        """
        path = self._place(entry)
        stamp = file_stamp(path)
        data = read_bytes(path, MAX_FILE_BYTES)
        people = [_cropped(somebody, path, stamp) for somebody, _ in chosen]
        parts = [hashlib.sha256(data).hexdigest(), [_content(person) for person in people], self._decoder]
        name = sha256_record(parts)
        kept = self._known.get(name)
        if kept is None:
            picture, turned = upright_picture(path, data)
            record = {
                "pixels": sha256_arrays(picture),
                "look": picture_look(picture),
                "size": [picture.shape[1], picture.shape[0]],
                "identities": [p.identity_with(cut(picture, p.crop.region, p.shape)) for p in people],
                "turned": turned,
            }
            self._known.put(name, json.dumps(record).encode())
        else:
            record = parse_json(kept.tobytes(), "cached identities")
        width, height = record["size"]
        listed = (entry.image.get("width", width), entry.image.get("height", height))
        if listed != (width, height):
            is_turned = record["turned"] and listed == (height, width)
            hint = " (its EXIF record turns it: annotate the upright picture)" if is_turned else ""
            words = f"{width} x {height} pixels, annotated as {listed[0]} x {listed[1]}{hint}"
            raise InputError(f"{self._what(entry)}: {words}")
        known = {"photograph": entry.image["file_name"], "licence": entry.licence}
        known |= {"pixels": record["pixels"], "look": record["look"]}
        return [
            (somebody.what, text, person.known_as(identity, **known))
            for (somebody, text), person, identity in zip(chosen, people, record["identities"], strict=True)
        ]


def _content(person: Person) -> str:
    """Hash all of a person but her pixels."""
    crop, (boxes, *landmarks) = person.crop, person.numbers
    mask = np.frombuffer(crop.packed, np.uint8)
    return sha256_arrays(mask, np.array(crop.region), np.array(crop.shape), boxes, *landmarks)


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
        Crop(path, stamp, region, shape, pack_mask(cut(somebody.mask, region, shape))),
        move(somebody.box),
        somebody.landmarks.moved((float(left), float(top)), scale),
        tuple(move(box) for box in somebody.others),
    )
