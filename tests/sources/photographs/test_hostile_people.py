"""200 hostile people files: each gives people who can be fitted and looked at, or one line that names the file.

Made by seed from a sound file: fields that change their value or vanish, entries doubled, dropped and mixed up, masks
and landmarks that are nearly right, photographs that are damaged or not what they seem.
"""

import copy
import json
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.files.errors import InputError
from cloak_core.sources.photographs.fits import fit_people
from cloak_core.sources.photographs.people import load_people
from tests.sources.photographs.made_people import write_people
from tests.sources.photographs.test_people_files import HOSTILE, places

FILES, AT_ONCE = 200, 25
Change = Callable[[random.Random, dict, Path], None]


def value_replaced(draw: random.Random, record: dict, folder: Path) -> None:
    """Any value at all becomes a hostile one."""
    *way, last = draw.choice([place for place in places(record) if place])
    within(record, way)[last] = draw.choice(HOSTILE)


def key_dropped(draw: random.Random, record: dict, folder: Path) -> None:
    *way, last = draw.choice([place for place in places(record) if place and isinstance(place[-1], str)])
    within(record, way).pop(last)


def within(record: dict, way: list) -> dict | list:
    for key in way:
        record = record[key]
    return record


def entry_doubled(draw: random.Random, record: dict, folder: Path) -> None:
    entries = draw.choice([record["images"], record["annotations"]])
    entries.append(copy.deepcopy(draw.choice(entries)) | draw.choice([{}, {"id": 99}, {"id": None}]))


def entries_mixed_up(draw: random.Random, record: dict, folder: Path) -> None:
    """One field of all annotations, or images, goes to others of them."""
    entries = draw.choice([record["images"], record["annotations"]])
    field = draw.choice(list(entries[0]))
    values = [entry.get(field) for entry in entries]
    for entry, value in zip(entries, values[1:] + values[:1], strict=True):
        entry[field] = value


def numbers_scaled(draw: random.Random, record: dict, folder: Path) -> None:
    """Landmarks, or a box, in another unit."""
    annotation = draw.choice(record["annotations"])
    factor = draw.choice([0.0, 1 / 300, 2.0, -1.0, 1e9, 1e-9, 1e308])
    if draw.random() < 0.5:
        annotation["bbox"] = [factor * x for x in annotation["bbox"]]
        return
    holder = annotation.get("blazepose", annotation)
    key = draw.choice(["xy", "z"]) if "blazepose" in annotation else "keypoints"
    holder[key] = [factor * x for x in holder[key]]


def landmarks_collapsed(draw: random.Random, record: dict, folder: Path) -> None:
    """All joints in one place, or on a line."""
    annotation = draw.choice(record["annotations"])
    if "blazepose" in annotation:
        xy = np.array(annotation["blazepose"]["xy"]).reshape(-1, 2)
        xy[:, draw.randrange(2)] = xy[11, 0]
        annotation["blazepose"]["xy"] = xy.ravel().tolist()
    else:
        points = np.array(annotation["keypoints"]).reshape(-1, 3)
        points[:, draw.randrange(3)] = draw.choice([0.0, 1.0, 130.0])
        annotation["keypoints"] = points.ravel().tolist()


def mask_replaced(draw: random.Random, record: dict, folder: Path) -> None:
    annotation = draw.choice(record["annotations"])
    height, width = annotation["segmentation"]["size"]
    annotation["segmentation"] = draw.choice(
        [
            {"size": [height, width], "counts": [height * width]},
            {"size": [height, width], "counts": [0, height * width]},
            {"size": [height, width], "counts": [0] * 999 + [height * width]},
            {"size": [height, width], "counts": [True] * height * width},
            {"size": [height, width], "counts": "0" * 10_000},
            {"size": [height, width], "counts": "oooooooooooo0"},
            {"size": [float(height), width], "counts": [height * width]},
            [[0, 0, width, 0, width, height, 0, height]],
            [[5, 5] * 1000],
            [[0, 0, width, height, 0, height], []],
            [[1e-300, 0, width, 0, width, height]],
        ]
    )


def photograph_replaced(draw: random.Random, record: dict, folder: Path) -> None:
    path = folder / f"made{draw.randrange(2)}.png"
    how = draw.randrange(7)
    if how == 0:
        path.write_bytes(path.read_bytes()[: draw.choice([0, 8, 40, 3000])])
    elif how == 1:
        path.unlink()
        path.mkdir()
    elif how == 2:
        Image.open(path).convert("CMYK").save(path, "JPEG")
    elif how == 3:
        Image.fromarray(np.full((300, 260), 40_000, np.uint16)).save(path)
    elif how == 4:
        frames = [Image.new("P", (260, 300), k) for k in range(3)]
        frames[0].save(path, "GIF", save_all=True, append_images=frames[1:], transparency=0)
    elif how == 5:
        Image.new("RGBA", (draw.choice([1, 260, 299]), 300)).save(path)
    else:
        data = bytearray(path.read_bytes())
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        path.write_bytes(data)


def name_replaced(draw: random.Random, record: dict, folder: Path) -> None:
    names = ["../made0.png", "/dev/zero", ".", "people.json", "made0.png/", "./made0.png", "a\nb.png", "-", "made1.png"]
    draw.choice(record["images"])["file_name"] = draw.choice(names)


CHANGES: tuple[Change, ...] = (
    value_replaced, key_dropped, entry_doubled, entries_mixed_up, numbers_scaled, landmarks_collapsed, mask_replaced,
    photograph_replaced, name_replaced,
)  # fmt: skip


def hostile(seed: int, folder: Path) -> str:
    """Write a hostile file with its photographs into a new folder; returns what load_people is asked for."""
    draw = random.Random(seed)
    path = write_people(folder, 2, draw.choice(["blazepose", "keypoints"]))
    record = json.loads(path.read_text())
    record |= {"licenses": [{"id": 1, "name": "CC0"}], "categories": [{"id": 1, "name": "person"}]}
    for image in record["images"]:
        image["license"] = 1
    for change in draw.choices(CHANGES, k=draw.randint(1, 3)):
        try:
            change(draw, record, folder)
        except (KeyError, TypeError, AttributeError, IndexError, ValueError, OSError):
            continue  # an earlier change took away what this one changes
    data = bytearray(json.dumps(record).encode())
    if draw.random() < 0.2:
        at = draw.randrange(len(data))
        data[at : at + draw.randint(0, 3)] = draw.choice([b"", b"\xff", b"[", b"1e999", b"null", b"\0"])
    path.write_bytes(data)
    return str(path) + draw.choice(["", "", "", "[0::2]", "[made*]", "[5]"])


@pytest.mark.long
@pytest.mark.timeout(240)
@pytest.mark.parametrize("first", range(0, FILES, AT_ONCE))
def test_hostile_people_are_read_or_refused(first: int, tmp_path: Path) -> None:
    read = 0
    for seed in range(first, first + AT_ONCE):
        spec = hostile(seed, tmp_path / str(seed))
        try:
            people = load_people(spec)
            fit_people(people)
            assert all(person.image.shape[:2] == person.mask.shape for person in people)
            read += 1
        except InputError as error:
            assert str(error).isprintable() and named(str(error), tmp_path / str(seed)), (seed, error)
        except Exception as error:
            raise AssertionError(f"file {seed}") from error
    assert 0 < read < AT_ONCE


def named(words: str, folder: Path) -> bool:
    """Whether a message names the file; of all its people together it has the name alone."""
    return str(folder) in words or words.startswith("people: ")
