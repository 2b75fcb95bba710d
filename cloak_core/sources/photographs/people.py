"""People in photographs, as files in COCO's format describe them.

Each person that can be dressed becomes a crop of the photograph with a mask and landmarks; the others are counted by
the reason why not.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_text
from cloak_core.files.specs import select, split_selection
from cloak_core.sources.photographs.coco import people_by_image, read_coco
from cloak_core.sources.photographs.person import Person
from cloak_core.sources.photographs.reader import Entry, Reader

MAX_LIST_BYTES = 1 << 20
_COMMA = re.compile(r",(?![^\[\]]*\])")
"""Between files; those of a selection, PEOPLE.json[0,2], stand in brackets."""


@dataclass(frozen=True, eq=False)
class People:
    """The people of a file who can be dressed, and why the others cannot."""

    people: tuple[Person, ...]
    """In the order of the file."""
    left_out: dict[str, int]
    """Reason -> how many: "crowd", "no landmarks", "no mask", "hidden", "cut", "small", "not upright", "sitting",
    "listed twice"."""
    name: str = "people"
    """What a run's record calls them."""

    def __len__(self) -> int:
        return len(self.people)

    def __iter__(self) -> Iterator[Person]:
        return iter(self.people)

    @property
    def photographs(self) -> tuple[str, ...]:
        """File names, in order, each photograph once."""
        return tuple(dict.fromkeys(person.photograph for person in self.people))

    def halves(self) -> tuple[People, People]:
        """The people of every second photograph, and those of the others. `InputError`: there is only one."""
        names = self.photographs
        if len(names) < 2:
            raise InputError(f"{self.name}: one photograph cannot be both trained on and unseen")
        first = frozenset(names[::2])
        parts = ([], [])
        for person in self.people:
            parts[person.photograph not in first].append(person)
        return tuple(replace(self, people=tuple(part)) for part in parts)


def load_people(spec: str | os.PathLike, images: str | os.PathLike | None = None) -> People:
    """Read people in photographs from COCO files: PEOPLE.json, or PEOPLE.json[0::2] for every second photograph.

    spec: one file, several with commas between them, a pattern (shards/*.json), or LIST.txt with one of these a line,
    from its own folder. images: the photographs' folder; None: each file's own, or `images` in it. A selection counts
    or names photographs (see `files.specs`). Only annotations of people count (`coco.PERSON_NAMES`); a
    photograph under two names is one, and what is said of it twice counts once. Photographs without anybody to dress
    are not opened, the others again when somebody is drawn. `InputError` names annotation and file for whatever is
    broken or does not fit the picture.
    """
    people: list[Person] = []
    left_out: Counter[str] = Counter()
    seen: set[str] = set()
    files = _files(str(spec))
    for file in files:
        chosen, reasons = _read_file(file, images)
        left_out.update(reasons)
        for person in chosen:
            # Shards may overlap.
            if len(files) > 1 and person.identity in seen:
                left_out["listed twice"] += 1
                continue
            seen.add(person.identity)
            people.append(person)
    if not people:
        reasons = ", ".join(f"{reason} {count}" for reason, count in left_out.items()) or "no annotation"
        raise InputError(f"{spec}: nobody in it can be dressed ({reasons})")
    return People(tuple(people), dict(left_out), Path(split_selection(files[0])[0]).stem)


def _files(spec: str) -> list[str]:
    """List the files, each with its selection, that a spec names. InputError: there are none."""
    if Path(split_selection(spec)[0]).is_file():
        return _listed(spec)
    return [file for part in _COMMA.split(spec) if part.strip() for file in _listed(part.strip())] or [spec]


def _listed(spec: str) -> list[str]:
    path, selection = split_selection(spec)
    if Path(path).suffix == ".txt":
        lines = [line.strip() for line in read_text(path, MAX_LIST_BYTES).splitlines()]
        names = [line for line in lines if line and not line.startswith("#")]
        if selection is not None or not names:
            raise InputError(f"{spec}: a list of people's files holds one a line, each with its own selection")
        places = [os.path.join(os.path.dirname(path), name) for name in names]
        if absent := [place for place in places if "*" not in place and not Path(split_selection(place)[0]).is_file()]:
            raise InputError(f"{path}: a list of people's files, and {absent[0]} is no file")
        return [file for place in places for file in _files(place)]
    if "*" in path and not Path(path).is_file():
        folder, pattern = os.path.split(path)
        files = sorted(str(file) for file in Path(folder or ".").glob(pattern) if file.is_file())
        if not files:
            raise InputError(f"{spec}: no file has such a name")
        return [file + spec[len(path) :] for file in files]
    return [spec]


def _read_file(spec: str, images: str | os.PathLike | None) -> tuple[list[Person], Counter[str]]:
    """Read one file: who can be dressed, and how many others there are by reason."""
    path, selection = split_selection(spec)
    record = read_coco(path)
    folders = [Path(images)] if images is not None else [Path(path).parent, Path(path).parent / "images"]
    listed = record["images"]
    if selection is not None:
        names = [str(entry.get("file_name")) for entry in listed]
        listed = [listed[i] for i in select(selection, names, spec)]
    licences = {entry.get("id"): str(entry.get("name")) for entry in record.get("licenses") or []}
    of_image = people_by_image(record, path)
    del record  # COCO's own file takes a gigabyte as Python objects
    entries = (
        Entry(image, of_image.get(repr(image.get("id")), []), licences.get(image.get("license"), ""))
        for image in listed
    )
    people: list[Person] = []
    left_out: Counter[str] = Counter()
    disordered: list[str] = []
    for what, person in Reader(path, folders).people(entries):
        if isinstance(person, Person):
            people.append(person)
        else:
            left_out[person] += 1
            disordered += [what] * (person == "not upright")
    if len(disordered) > len(people):  # few people stand on their heads
        raise InputError(
            f"{disordered[0]}: keypoints of another order? shoulders, hips, knees and ankles do not follow each other "
            f"downwards, in {len(disordered)} of {len(disordered) + len(people)} people"
        )
    return people, left_out
