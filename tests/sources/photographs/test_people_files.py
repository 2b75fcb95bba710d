"""Reading people: every way a COCO file writes a mask, who is left out, and bad input in one line."""

import copy
import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core import wear
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.files.errors import InputError
from cloak_core.sources.photographs import reader
from cloak_core.sources.photographs.annotation import draw_mask, read_mask
from cloak_core.sources.photographs.fits import fit_people, fits_well, those_who_fit
from cloak_core.sources.photographs.people import load_people
from tests.core.fakes import Says
from tests.sources.photographs.made_people import SIZE, edit, photograph, write_people
from tests.studies.test_wearing import less_red

pytestmark = pytest.mark.slow


def decode_mask(segmentation, height, width):
    return draw_mask(read_mask(segmentation, height, width, "it"), height, width)


def test_run_lengths_go_by_column_and_begin_with_zeros():
    mask = decode_mask({"size": [2, 3], "counts": [1, 2, 3]}, 2, 3)
    assert mask.tolist() == [[False, True, False], [True, False, False]]


@pytest.mark.parametrize("seed", range(5))
def test_packed_run_lengths_are_pycocotools(seed):
    tools = pytest.importorskip("pycocotools.mask")
    mask = np.random.default_rng(seed).random((37, 53)) < (0.5 if seed else 0.01)
    packed = tools.encode(np.asfortranarray(mask.astype(np.uint8)))
    decoded = decode_mask({"size": [37, 53], "counts": packed["counts"].decode()}, 37, 53)
    assert (decoded == mask).all()


def test_people_are_read_with_their_landmarks(tmp_path):
    people = load_people(write_people(tmp_path))
    assert len(people) == 2 and people.photographs == ("made0.png", "made1.png") and not people.left_out
    person = people.people[0]
    assert person.mask.shape == person.image.shape[:2]
    x0, y0, x1, y1 = person.box
    assert person.mask[int(y0) : int(y1), int(x0) : int(x1)].sum() == person.mask.sum()


def test_photographs_may_lie_in_a_folder_of_their_own(tmp_path):
    path = write_people(tmp_path)
    for k in range(2):
        (tmp_path / "images").mkdir(exist_ok=True)
        (tmp_path / f"made{k}.png").rename(tmp_path / "images" / f"made{k}.png")
    assert len(load_people(path)) == 2
    (tmp_path / "images").rename(tmp_path / "elsewhere")
    assert len(load_people(path, tmp_path / "elsewhere")) == 2


def sit(annotation):
    xy = np.array(annotation["blazepose"]["xy"]).reshape(33, 2)
    xy[[25, 26]] = xy[[23, 24]] + [0, 5]
    annotation["blazepose"]["xy"] = xy.ravel().tolist()


def stand_on_the_head(annotation):
    xy = np.array(annotation["blazepose"]["xy"]).reshape(33, 2)
    order = [*range(11), 27, 28, *range(13, 23), 25, 26, 23, 24, 11, 12, *range(29, 33)]
    annotation["blazepose"]["xy"] = xy[order].ravel().tolist()


LEFT_OUT = {
    "crowd": lambda a: a.update(iscrowd=1),
    "no mask": lambda a: a.pop("segmentation"),
    "no landmarks": lambda a: a.pop("blazepose"),
    "hidden": lambda a: a["blazepose"].update(visibility=[0.1] * 33),
    "small": lambda a: a.update(bbox=[100, 100, 20, 50]),
    "cut": lambda a: a["blazepose"]["xy"].__setitem__(55, 400.0),
    "sitting": sit,
    "not upright": stand_on_the_head,
}


@pytest.mark.parametrize("reason", LEFT_OUT)
def test_who_cannot_be_dressed_is_counted_by_reason(tmp_path, reason):
    path = edit(write_people(tmp_path), lambda record: LEFT_OUT[reason](record["annotations"][1]))
    people = load_people(path)
    assert len(people) == 1 and people.left_out == {reason: 1}


BROKEN = {
    "run lengths add up to": lambda a: a["segmentation"]["counts"].append(7),
    "broken run lengths": lambda a: a["segmentation"].update(counts="\x7f\x7f"),
    "its mask has size": lambda a: a["segmentation"].update(size=[5, 5]),
    "a polygon lies outside": lambda a: a.update(segmentation=[[0, 0, 900, 0, 900, 900]]),
    "a list of at least three": lambda a: a.update(segmentation=[[0, 0, 9, 9]]),
    "neither polygons nor run lengths": lambda a: a.update(segmentation="mask.png"),
    "33 landmarks have 66": lambda a: a["blazepose"].update(xy=[1.0] * 34),
    "not a list of numbers": lambda a: a["blazepose"].update(xy=["left"] * 66),
    "bbox lies outside": lambda a: a.update(bbox=[0, 0, 4000, 10]),
}


@pytest.mark.parametrize("words", BROKEN)
def test_broken_annotations_are_named_in_one_line(tmp_path, words):
    path = edit(write_people(tmp_path), lambda record: BROKEN[words](record["annotations"][1]))
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        load_people(path)
    assert "annotation 2 (made1.png)" in str(caught.value) and "\n" not in str(caught.value)


def test_photographs_are_taken_from_the_folder_alone(tmp_path):
    path = write_people(tmp_path, kind="coco")
    (tmp_path / "made1.png").unlink()
    with pytest.raises(InputError, match=r"image 2 \(made1.png\): no such photograph"):
        load_people(path)
    edit(path, lambda record: record["images"][0].update(file_name="../made0.png"))
    with pytest.raises(InputError, match="leads out"):
        load_people(path)
    edit(path, lambda record: record["annotations"][0].update(keypoints=[1, 2, 2] * 18))
    with pytest.raises(InputError, match="54 numbers of keypoints, COCO has 17"):
        load_people(path)


def test_a_photograph_that_exif_turns_is_named(tmp_path):
    path = write_people(tmp_path)
    exif = Image.Exif()
    exif[274] = 6
    photograph().save(tmp_path / "turned.jpg", exif=exif)
    edit(path, lambda record: record["images"][1].update(file_name="turned.jpg"))
    with pytest.raises(InputError, match=rf"image 2 \(turned.jpg\).*annotated as {SIZE[1]} x {SIZE[0]}.*EXIF"):
        load_people(path)


@pytest.mark.parametrize("content", ['{"images": []}', "[]", '{"images": 3, "annotations": []}'])
def test_another_file_is_refused(tmp_path, content):
    path = tmp_path / "people.json"
    path.write_text(content)
    with pytest.raises(InputError, match="people"):
        load_people(path)


def test_a_photograph_is_read_again_when_somebody_looks_and_only_if_it_is_the_same(tmp_path):
    person = load_people(write_people(tmp_path, 1)).people[0]
    photograph(seed=5).save(tmp_path / "made0.png")
    with pytest.raises(InputError, match=r"made0.png: the photograph changed"):
        _ = person.image


def test_a_second_reading_knows_everybody_without_decoding(tmp_path, monkeypatch):
    monkeypatch.setenv("CLOAK_CACHE", str(tmp_path / "cache"))
    path = write_people(tmp_path, 2)
    first = load_people(path)
    monkeypatch.setattr(reader, "upright_picture", None)
    again = load_people(path)
    assert [p.identity for p in again] == [p.identity for p in first] and again.photographs == first.photographs


def test_several_files_are_one_set_and_nobody_counts_twice(tmp_path):
    one, other = write_people(tmp_path / "a", 2), write_people(tmp_path / "b", 3)
    (tmp_path / "list.txt").write_text("# shards\na/people.json[0,1]\n\nb/people.json\n")
    for spec in (f"{one},{other}", tmp_path / "list.txt", f"{one}[0,1],{other}"):
        people = load_people(spec)
        assert len(people) == 3 and people.left_out == {"listed twice": 2}
    other.rename(tmp_path / "a" / "more.json")
    with pytest.raises(InputError, match=r"image 3 .made2.png.: no such photograph"):
        load_people(tmp_path / "a" / "*.json")
    assert len(load_people(f"{tmp_path / 'a' / '*.json'}[0]")) == 1


def widened(*numbers):
    """Give these annotations a mask that fills the photograph's middle: the body covers a small part of it."""

    def change(record):
        width = SIZE[1]
        for number in numbers:
            _, top, _, height = record["annotations"][number]["bbox"]
            bottom = top + height
            record["annotations"][number]["segmentation"] = [[2, top, width - 2, top, width - 2, bottom, 2, bottom]]

    return change


def test_a_body_that_does_not_fit_is_left_out(tmp_path):
    people = load_people(edit(write_people(tmp_path, 3), widened(1)))
    fits = fit_people(people)
    assert len(people) == 3 and all(fits_well(fit.quality) for fit in fits)
    fitting = those_who_fit(people, fits)
    assert fitting.left_out["does not fit"] == 1 and fitting.photographs == ("made0.png", "made2.png")
    found = wear(["zoo:builtin-sample"], people, {"d": Says(less_red)}, settings=WearSettings(size=96, bare=2))
    assert found["people"] == 2 and found["left_out"]["does not fit"] == 1
    with pytest.raises(InputError, match="people: the body fits none of its 2 people"):
        fit_people(load_people(edit(write_people(tmp_path / "none", 2), widened(0, 1))))


def test_a_list_of_nothing_is_refused(tmp_path):
    (tmp_path / "list.txt").write_text("# none\n")
    for spec, words in ((tmp_path / "list.txt", "holds one a line"), (tmp_path / "*.json", "no file has such a name")):
        with pytest.raises(InputError, match=words):
            load_people(spec)


def test_a_photograph_with_nobody_to_dress_is_not_opened(tmp_path):
    path = edit(write_people(tmp_path), lambda record: record["annotations"][1].update(iscrowd=1))
    (tmp_path / "made1.png").unlink()
    people = load_people(path)
    assert len(people) == 1 and people.left_out == {"crowd": 1}
    edit(path, lambda record: record["annotations"][0].update(iscrowd=1))
    with pytest.raises(InputError, match=r"nobody in it can be dressed \(crowd 2\)"):
        load_people(path)


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
