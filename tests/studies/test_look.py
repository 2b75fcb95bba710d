"""One view, cloaked and in own clothing, before a detector whose mind is known."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from cloak_core.commands import detectors as command
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.face_lists import write_colors, write_face_list
from cloak_core.exchange.scenes import write_scene
from cloak_core.files.errors import InputError
from cloak_core.studies.look import Look, Looker
from tests.core.fakes import Says, around
from tests.schemas import validate

RED, GREEN = (0.9, 0.1, 0.1), (0.0, 1.0, 0.0)


def is_red(images: torch.Tensor) -> torch.Tensor:
    return (images[:, 0] > 0.5) & (images[:, 1:].amax(1) < 0.2)


def sees_red() -> Says:
    """Finds a person around whatever is red."""
    return Says(lambda images: 0.8 * is_red(images).flatten(1).any(1), lambda images: around(is_red(images)))


@pytest.fixture
def box(tmp_path: Path) -> dict:
    """A red wall of two triangles, 1 m wide and 1 m high at (0.5, 1, 0), that a green cloak can hide; a look at it."""
    corners = np.float32([[0, 0.5, 0], [1, 0.5, 0], [1, 1.5, 0], [0, 1.5, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    bodies = Bodies(vertices=corners[None], triangles=triangles, face_colors=np.float32([[RED, RED]]), name="wall")
    write_face_list(tmp_path / "logo.npy", np.arange(2), bodies.topology)
    write_colors(tmp_path / "colors.npy", np.float32([GREEN, GREEN]))
    record = {"scene": str(write_scene(tmp_path / "scene", bodies)), "out": str(tmp_path / "out")}
    return record | {"width": 60, "height": 40, "elevation": 0, "distance": 2}


def test_boxes_lie_where_the_camera_sees_the_body(box):
    """Focal length 20 / tan 30: a metre, 2 m away, is 17 pixels; straight ahead, and beside the middle."""
    told = Looker({"red": sees_red()}).look(Look.of(box))
    seen = told["detectors"]["red"]["clothing"]
    assert seen["max_person"] == pytest.approx(0.8) and "cloak" not in told["detectors"]["red"]
    assert np.allclose(seen["boxes"][0][:4], [30 - 8.7, 20 - 8.7, 30 + 8.7, 20 + 8.7], atol=1)
    aside = Looker({"red": sees_red()}).look(Look.of(box | {"pivot": [0, 1, 0.0]}))["detectors"]["red"]["clothing"]
    assert np.allclose(aside["boxes"][0][:4], [30, 20 - 8.7, 30 + 17.3, 20 + 8.7], atol=1)
    record = validate("look", Path(box["out"], "look.json").read_text())
    assert Image.open(record["pictures"]["clothing"]).size == (60, 40)


def test_a_runs_cloth_is_worn_as_fine_as_it_is_printed(box, tmp_path):
    """Left half red, right half green, 1 m wide: on either of the wall's triangles, whose mean is neither."""
    halves = np.uint8([[[230, 25, 25], [0, 255, 0]]])
    Image.fromarray(halves).save(tmp_path / "cloth.png")
    (tmp_path / "config.json").write_text(json.dumps({"settings": {"tile_cm": 100}}))
    worn = box | {"logo": str(tmp_path / "logo.npy"), "colors": str(tmp_path / "colors.npy"), "cloth": str(tmp_path)}
    told = Looker({"red": sees_red()}).look(Look.of(worn))
    picture = np.asarray(Image.open(told["pictures"]["cloak"]))
    red = (picture[..., 0] > 100) & (picture[..., 1] < 60)
    green = (picture[..., 1] > 100) & (picture[..., 0] < 60)
    assert np.flatnonzero(red[20])[[0, -1]].tolist() == [21, 29], "the left half of the wall"
    assert np.flatnonzero(green[20])[[0, -1]].tolist() == [30, 38]
    (tmp_path / "cloth.png").unlink()
    assert Looker({"red": sees_red()}).look(Look.of(worn))["detectors"]["red"]["cloak"]["max_person"] == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scene": None}, "scene"),
        ({"angle": 3}, "no key 'angle'"),
        ({"width": "wide"}, "width.*not a whole number"),
        ({"pivot": [1, 2]}, "not three numbers"),
        ({"pivot": [1, 2, "x"]}, "pivot"),
        ({"pose": 1}, "pose 1: scene .* has 1"),
        ({"scene": "/nowhere"}, "/nowhere"),
        ({"out": "/dev/null/x"}, "/dev/null/x: cannot be written"),
    ],
)
def test_what_cannot_be_looked_at_is_named(box, change, words):
    with pytest.raises(InputError, match=words):
        Looker({"red": sees_red()}).look(Look.of(box | change))


def test_requests_come_a_line_each_and_a_bad_one_ends_nothing(box, tmp_path, monkeypatch, capsys):
    places = [tmp_path / "a", tmp_path / "b", tmp_path / "c"]
    for place in places:
        place.mkdir()
    lines = [{"width": 10}, {"pose": 9}, {}]
    asked = [json.dumps(box | change | {"out": str(place)}) for change, place in zip(lines, places, strict=True)]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join([*asked, "{nonsense"]) + "\n"))
    assert command.answer_lines(Looker({"red": sees_red()})) == 4
    told = [json.loads((place / "look.json").read_text()) for place in places]
    assert (told[0]["width"], told[2]["width"]) == (10, 60) and "pose 9" in told[1]["error"]
    said = capsys.readouterr().err
    assert "pose 9" in said and "request 4: not valid JSON" in said
