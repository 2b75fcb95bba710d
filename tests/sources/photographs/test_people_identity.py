"""Who is in a file: known by content, counted once, and people alone."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.core.run_config import DECISIVE, check_same
from cloak_core.files.errors import InputError
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.fits import people_identity
from cloak_core.sources.photographs.people import load_people
from cloak_core.sources.photographs.person import Person, file_stamp, pack_mask
from tests.sources.photographs.made_people import edit, write_people

pytestmark = pytest.mark.slow


def nearer(person: Person) -> Person:
    """Her left knee moved towards the camera, and nothing else."""
    depth = person.landmarks.depth.copy()
    depth[11] += 30
    return replace(person, landmarks=replace(person.landmarks, depth=depth))


def masked(person: Person) -> Person:
    mask = person.mask & (np.arange(person.shape[1]) > person.box[0] + 3)
    return replace(person, crop=replace(person.crop, packed=pack_mask(mask)))


def in_other_pixels(person: Person) -> Person:
    path = person.crop.path.with_name("other.png")
    Image.fromarray(255 - np.array(Image.open(person.crop.path))).save(path)
    return replace(person, crop=replace(person.crop, path=path, stamp=file_stamp(path)))


CHANGES = {
    "depth": nearer,
    "no depth": lambda p: replace(p, landmarks=replace(p.landmarks, depth=None)),
    "visibility": lambda p: replace(p, landmarks=replace(p.landmarks, visibility=p.landmarks.visibility * 0.9)),
    "box": lambda p: replace(p, box=(p.box[0] + 1, *p.box[1:])),
    "others": lambda p: replace(p, others=((0.0, 0.0, 5.0, 5.0),)),
    "mask": masked,
    "pixels": in_other_pixels,
}


@pytest.mark.parametrize("what", CHANGES)
def test_whatever_decides_a_figure_is_part_of_who_she_is(tmp_path: Path, what: str) -> None:
    (person,) = load_people(write_people(tmp_path, 1))
    assert people_identity([CHANGES[what](person)]) != people_identity([person])


def test_names_are_no_part_of_who_she_is(tmp_path: Path) -> None:
    people = load_people(write_people(tmp_path))
    (tmp_path / "renamed").mkdir()
    shutil.copy(tmp_path / "made0.png", tmp_path / "renamed" / "other.png")
    shutil.copy(tmp_path / "made1.png", tmp_path / "renamed" / "made1.png")
    path = shutil.copy(tmp_path / "people.json", tmp_path / "renamed" / "list.json")
    edit(path, lambda record: record["images"][0].update(file_name="other.png"))
    renamed = load_people(path)
    assert renamed.photographs == ("other.png", "made1.png") and people_identity(renamed) == people_identity(people)
    assert [person.pixels for person in renamed] == [person.pixels for person in people]


def annotation_twice(record: dict) -> None:
    first = record["annotations"][0]
    record["annotations"] += [first, first | {"id": 77}]


def photograph_twice(record: dict) -> None:
    image, person = record["images"][0], record["annotations"][0]
    record["images"] += [image, image | {"id": 9, "file_name": "copy.png"}]
    record["annotations"].append(person | {"id": 9, "image_id": 9})


@pytest.mark.parametrize("twice", [annotation_twice, photograph_twice])
def test_what_is_listed_twice_counts_once_whatever_it_is_called(tmp_path: Path, twice: Callable) -> None:
    path = write_people(tmp_path)
    shutil.copy(tmp_path / "made0.png", tmp_path / "copy.png")
    people = load_people(edit(path, twice))
    assert people.photographs == ("made0.png", "made1.png") and people.left_out == {"listed twice": 2}
    # She is not somebody else who stands where she does.
    assert all(person.others == () for person in people)


def test_people_of_a_copied_photograph_stay_in_one_half(tmp_path: Path) -> None:
    path = write_people(tmp_path)
    shutil.copy(tmp_path / "made0.png", tmp_path / "made1.png")
    people = load_people(path)
    assert len(people) == 2 and people.photographs == ("made0.png",)
    with pytest.raises(InputError, match="one photograph cannot be both"):
        people.halves()


REFUSED = {
    "categories: none is called person": lambda r: r.update(categories=[{"id": 1, "name": "horse"}]),
    "annotation 2: category 1 is none of the file's": lambda r: (
        r.update(categories=[{"id": 3, "name": "person"}]),
        r["annotations"][0].update(category_id=3),
    ),
    "annotation 1: two different ones have this id": lambda r: r["annotations"][1].update(id=1),
    "image 1: stands for both made0.png and made1.png": lambda r: r["images"][1].update(id=1),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_contradicts_itself_is_refused_in_one_line(tmp_path: Path, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        load_people(edit(write_people(tmp_path), REFUSED[words]))
    assert "people.json" in str(caught.value) and "\n" not in str(caught.value)


def test_a_training_goes_on_with_the_same_people_alone(tmp_path: Path) -> None:
    people = load_people(write_people(tmp_path, 1))
    own = Crowd(people).record()
    config = lambda record: dict.fromkeys(DECISIVE) | {"people": record}
    recorded = json.loads(json.dumps(own))
    check_same(config(recorded), config(own), tmp_path)
    for change in (nearer, CHANGES["others"]):
        other = config(Crowd(replace(people, people=(change(people.people[0]),))).record())
        with pytest.raises(InputError, match=r"was started with people\.identity = "):
            check_same(config(recorded), other, tmp_path)
    # Before 0.9 a run recorded hashes of its fits, which were finer then: it is refused, not continued with others.
    with pytest.raises(InputError, match=r"was started with people\.sha256 = "):
        check_same(config({"sha256": "0" * 64}), config(own), tmp_path)
