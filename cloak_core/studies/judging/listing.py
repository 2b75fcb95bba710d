"""Which pictures there are, and who is where in them: from folders' names, or from a CSV file.

Folders: DIR/with, DIR/without, DIR/nobody (for false alarms), and any other as a control garment of that name; inside,
PERSON/SCENE/file, PERSON/file or files alone. The same name under `with` and `without` makes a pair. A CSV says the
same in columns, and more: one row for each person in each picture.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cloak_core.files.errors import InputError
from cloak_core.files.records import number, read_table
from cloak_core.sources.bodies import videos

WITH, WITHOUT, NOBODY = "with", "without", "nobody"
LIST = "pictures.csv"
"""In DIR: taken instead of the folders' names where it is there."""
PICTURES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".gif", ".tif", ".tiff")
BESIDE = (".csv", ".txt", ".md", ".json", ".html", ".pdf")
"""What may lie among pictures and is not looked at."""
BOX = ("x1", "y1", "x2", "y2")
COLUMNS = ("file", "cloak", "person", "scene", "distance", "pair", *BOX)
WORDS = {"yes": WITH, "1": WITH, "true": WITH, "no": WITHOUT, "0": WITHOUT, "false": WITHOUT}
"""What `cloak` may say beside with, without, nobody and the name of a control."""
_log = logging.getLogger("cloak")


@dataclass(frozen=True)
class Subject:
    """One person in one picture or video (or nobody)."""

    file: str
    """Relative to the folder, with forward slashes."""
    garment: str
    """with, without, nobody, or a control's name."""
    person: str = ""
    """ "": nobody said."""
    scene: str = ""
    """Where it was taken; "": nobody said."""
    pair: str = ""
    """Pictures of one pair show the same but for the garment."""
    distance: float | None = None
    """Metres."""
    box: tuple[float, float, float, float] | None = None
    """x1, y1, x2, y2 in the upright picture's pixels."""

    @property
    def place(self) -> str:
        """What the interval takes for a scene: the one told, else the pair, else the file."""
        return self.scene or self.pair or self.file


def list_subjects(
    folder: Path, table: Path | None = None, boxes: Path | None = None, leave: Sequence[Path] = ()
) -> list[Subject]:
    """List everybody in the pictures of a folder, by a CSV (`table`, else FOLDER/pictures.csv if it exists) or by its
    sub-folders, but for those to `leave`. boxes: a CSV of file, x1, y1, x2, y2 (and person), one row for each person.

    InputError: no such folder, nothing in it, a CSV that is none, or names a file outside the folder.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: {'not a folder' if folder.exists() else 'no such folder'}")
    if table is None and (folder / LIST).exists():
        table = folder / LIST
    subjects = list(_by_folders(folder, leave) if table is None else _by_table(folder, table))
    if not any(subject.garment in (WITH, WITHOUT) for subject in subjects):
        places = f"{folder / WITH} and {folder / WITHOUT}" if table is None else f"{table}"
        raise InputError(f"{places}: no picture of anybody")
    return subjects if boxes is None else list(_with_boxes(subjects, folder, boxes))


def _by_folders(folder: Path, leave: Sequence[Path]) -> Iterator[Subject]:
    away = {path.resolve() for path in leave}
    for garment in sorted(folder.iterdir()):
        if not garment.is_dir() or garment.name.startswith(".") or garment.resolve() in away:
            continue
        for path in sorted(garment.rglob("*")):
            inside = path.relative_to(garment)
            if path.is_dir() or any(part.startswith(".") for part in inside.parts):
                continue
            if path.suffix.lower() not in (*PICTURES, *videos.SUFFIXES):
                if path.suffix.lower() not in BESIDE:
                    _log.warning("%s: no kind of picture or video that is read here; skipped", path)
                continue
            person, *scene = (*inside.parts[:-1], "")
            yield Subject(
                file=path.relative_to(folder).as_posix(),
                garment=garment.name,
                person=person,
                scene="/".join(filter(None, scene)),
                pair=inside.with_suffix("").as_posix(),
            )


def _by_table(folder: Path, table: Path) -> Iterator[Subject]:
    for row in read_table(table, COLUMNS, ["file", "cloak"]):
        if "file" not in row or "cloak" not in row:
            raise InputError(f"{table}: a row without {'cloak' if 'file' in row else 'file'}")
        word = row["cloak"].lower()
        yield Subject(
            file=_inside(folder, row["file"], table),
            garment=WORDS.get(word, word),
            person=row.get("person", ""),
            scene=row.get("scene", ""),
            pair=row.get("pair", ""),
            distance=number(row, "distance", table) if "distance" in row else None,
            box=_box(row, table),
        )


def _with_boxes(subjects: list[Subject], folder: Path, table: Path) -> Iterator[Subject]:
    """Give each subject the table's boxes for its picture: its own person's row where that is named, else all rows."""
    boxes_by_file: dict[str, list[tuple[str, tuple]]] = {}
    for row in read_table(table, ("file", "person", *BOX), ["file", *BOX]):
        box = _box(row, table)
        if box is None or "file" not in row:
            raise InputError(f"{table}: a row without a whole box, or without a file")
        boxes_by_file.setdefault(_inside(folder, row["file"], table), []).append((row.get("person", ""), box))
    unknown = sorted(set(boxes_by_file) - {subject.file for subject in subjects})
    if unknown:
        raise InputError(f"{table}: '{unknown[0]}' is none of the pictures")
    for subject in subjects:
        rows = boxes_by_file.get(subject.file, [(subject.person, subject.box)])
        own_rows = [row for row in rows if row[0] == subject.person] if len(rows) > 1 and subject.person else []
        for person, box in own_rows or rows:
            yield replace(subject, person=person or subject.person, box=box)


def _box(row: dict[str, str], table: Path) -> tuple[float, float, float, float] | None:
    if not any(name in row for name in BOX):
        return None
    x1, y1, x2, y2 = (number(row, name, table) for name in BOX)
    if x2 <= x1 or y2 <= y1:
        raise InputError(f"{table}: the box {x1:g}, {y1:g}, {x2:g}, {y2:g} of '{row.get('file', '')}' has no area")
    return x1, y1, x2, y2


def _inside(folder: Path, file: str, table: Path) -> str:
    """Make a file's name relative to the folder. InputError: it lies outside."""
    path = (folder / file.replace("\\", "/")).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise InputError(f"{table}: '{file}' lies outside {folder}")
    return path.relative_to(folder.resolve()).as_posix()
