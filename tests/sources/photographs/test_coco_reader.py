"""A COCO file from anywhere: each field has its type, and a wrong one is named with its annotation."""

import copy
import itertools
import json
from pathlib import Path

import pytest

from cloak_core.files.errors import InputError
from cloak_core.sources.photographs.people import load_people
from tests.sources.photographs.made_people import write_people

HOSTILE = (
    "text", "", "7", [], [1], {}, {"id": 1}, None, True,
    float("nan"), float("inf"), -1, 0, 1e30, 2.5, 1 << 60, "x" * 300,
    "\0", "../../etc/passwd", "/etc/passwd", "\ud800", [[[]]], [None] * 51, [1e300] * 4, [0.0] * 51, [5.0] * 66,
)  # fmt: skip


@pytest.fixture(scope="module", params=["blazepose", "keypoints"])
def sound(request, tmp_path_factory) -> tuple[Path, dict]:
    path = write_people(tmp_path_factory.mktemp("people"), 2, request.param)
    record = json.loads(path.read_text())
    record["licenses"] = [{"id": 1, "name": "CC0"}]
    record["categories"] = [{"id": 1, "name": "person"}]
    for image in record["images"]:
        image["license"] = 1
    return path, record


def places(value: object, before: tuple = ()) -> list[tuple]:
    """List the paths of every value in a record; of long lists of numbers the first alone."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    few = itertools.islice(parts, 3 if isinstance(value, list) else None)
    return [before, *(place for key, part in few for place in places(part, (*before, key)))]


def with_value(record: dict, place: tuple, value: object) -> dict:
    changed = copy.deepcopy(record)
    *way, last = place
    inner = changed
    for key in way:
        inner = inner[key]
    inner[last] = value
    return changed


@pytest.mark.parametrize(
    ("table", "field", "value", "words"),
    [
        ("annotations", "id", "a", "annotation a: id 'a' is not a whole number"),
        ("annotations", "id", [1], r"annotation number 0: id \[1\] is not a whole number"),
        ("annotations", "id", float("nan"), "annotation number 0: id nan is not a whole number"),
        ("annotations", "image_id", {"id": 1}, "annotation 1: image_id {'id': 1} is not"),
        ("annotations", "category_id", "person", "annotation 1: category_id 'person' is not a whole number"),
        ("annotations", "iscrowd", "no", "annotation 1: iscrowd 'no' is not 0 or 1"),
        ("images", "id", [1], r"image number 0: id \[1\] is not a whole number or text"),
        ("images", "license", {"id": 1}, "image 1: license {'id': 1} is not"),
        ("images", "file_name", "x" * 300, "image 1: file_name 'x.*is not a file's name, of at most 255 bytes"),
        ("images", "width", "260", "image 1: width '260' is not a number of pixels"),
        ("licenses", "id", [1], r"licence number 0: id \[1\] is not"),
        ("licenses", "name", {}, "licence 1: name {} is not text"),
    ],
)
def test_a_field_of_another_type_is_named(sound, table: str, field: str, value: object, words: str) -> None:
    path, record = sound
    path.write_text(json.dumps(with_value(record, (table, 0, field), value)))
    with pytest.raises(InputError, match=rf"people\.json: {words}"):
        load_people(path)


def test_a_box_far_from_its_landmarks_is_named(sound) -> None:
    path, record = sound
    path.write_text(json.dumps(with_value(record, ("annotations", 0, "bbox"), [5.0, 5.0, 20.0, 100.0])))
    with pytest.raises(InputError, match=r"annotation 1 .*: bbox lies elsewhere than its landmarks"):
        load_people(path)
