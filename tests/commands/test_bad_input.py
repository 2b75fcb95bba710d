"""Bad input through the command line: one line that names the thing, exit code 2, nothing written or lost."""

import re
from pathlib import Path

import numpy as np
import pytest

from cloak_core import cli
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.face_lists import write_face_list
from cloak_core.exchange.scenes import read_scene, write_scene

TETRAHEDRON = """v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""
CFG = """[net]
width=32
height=32
channels=3

[convolutional]
filters=30
size=1
stride=1
activation=linear

[region]
anchors=1,1, 2,2, 3,3, 4,4, 5,5
classes=1
coords=4
num=5
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scene, a logo, a picture-less folder and a one-layer detector; also the working folder."""
    monkeypatch.chdir(tmp_path)
    Path("a.obj").write_text(TETRAHEDRON)
    bodies = Bodies(
        vertices=np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]], np.float32),
        triangles=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    )
    write_scene("scene", bodies)
    write_face_list("logo.npy", np.array([3]), bodies.topology)
    Path("empty").mkdir()
    Path("net.cfg").write_text(CFG)
    Path("net.names").write_text("person\n")
    return tmp_path


def refuse(line: str, capsys: pytest.CaptureFixture) -> str:
    """Run a command line that must be refused; returns what it says on standard error."""
    before = sorted(map(str, Path.cwd().rglob("*")))
    with pytest.raises(SystemExit) as end:
        cli.main(line.split())
    said = capsys.readouterr()
    assert end.value.code == 2, said.err
    assert not said.out
    lines = said.err.strip().splitlines()
    assert len(lines) == 1, said.err
    assert sorted(map(str, Path.cwd().rglob("*"))) == before, "something was written or lost"
    return lines[0]


TRAIN = "train --scene scene --logo logo.npy --out run --steps 1 "


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "words"),
    [
        (TRAIN + "--detector darknet:net.cfg:absent.weights", "absent.weights.* 120 floats"),
        (TRAIN + "--detector darknet:absent.cfg:absent.weights", "absent.cfg"),
        (TRAIN + "--detector nonsense:x", "nonsense"),
        (TRAIN + "--backgrounds empty", "empty: no jpg, png or webp"),
        (TRAIN + "--backgrounds absent", "absent: no such folder"),
        (TRAIN + "--lr nan", "--lr: nan"),
        (TRAIN + "--batch -3", "--batch: -3"),
        (TRAIN + "--angles 10:-10:5", "--angles: '10:-10:5' ends before it begins"),
        (TRAIN + "--preset nonsense", "--preset: 'nonsense'"),
        (TRAIN + "--config absent.toml", "absent.toml"),
        ("train --scene scene --logo absent.npy --out run", "absent.npy"),
        ("logo select --scene scene --region nonsense --out x.npy", "nonsense"),
        ("logo select --scene scene --box 0,1,0,1 --out x.npy", "--box 0,1,0,1: six numbers"),
        ("logo select --scene scene --out x.npy", "either --region or --box"),
        ("logo project --scene scene --mask absent.png --out x.npy", "absent.png"),
        ("logo heatmap --scene scene --detector builtin --out heat.npy --pick 2", "--pick 2"),
        ("detectors check builtin", "either --image, or --scene"),
        ("detectors check builtin --image absent.jpg", "absent.jpg: no such file"),
        ("evaluate empty", "empty: not a run folder"),
        ("report absent", "absent: no such folder"),
        ("report net.cfg", "net.cfg: a detector, not a run folder"),
        ("report empty", "empty: not a run folder"),
        ("zoo reproduce nonsense", "nonsense"),
        (TRAIN + "--device cuda:99", "--device cuda:99: "),
        (TRAIN + "--device meta", "--device meta: holds no numbers"),
        ("scene info sample:nonsense", "sample:nonsense"),
    ],
)
def test_one_line_names_the_thing(here, capsys, line, words):
    assert re.search(words, refuse(line, capsys))


def test_truncated_weights_say_how_many_floats_were_expected_and_found(here, capsys):
    Path("net.weights").write_bytes(np.array([0, 2, 0, 0, 0], np.int32).tobytes() + bytes(4 * 100))
    said = refuse(TRAIN + "--detector darknet:net.cfg:net.weights", capsys)
    assert re.search("expected 120 floats.*found 100", said)


def test_an_unknown_section_is_named_with_its_line(here, capsys):
    Path("net.cfg").write_text(CFG.replace("[region]", "[nonsense]"))
    assert re.search(r"net.cfg:12: \[nonsense\]", refuse(TRAIN + "--detector darknet:net.cfg:x", capsys))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ids", "words"),
    [
        ([1, 1], "duplicate face id 1"),
        ([4], "polygon id 4 is beyond the mesh's 4"),
        ([-1], "negative face id -1"),
        ([0.5], "not float64"),
    ],
)
def test_bad_face_ids(here, capsys, ids, words):
    np.save("bad.npy", np.array(ids))
    assert words in refuse("train --scene scene --logo bad.npy --out run", capsys)


def test_a_face_list_of_another_mesh_names_both_hashes(here, capsys):
    write_face_list("other.npy", np.array([0]), "f" * 64)
    said = refuse("train --scene scene --logo other.npy --out run", capsys)
    assert "f" * 64 in said and read_scene("scene").topology in said


def test_a_logo_that_no_view_sees(here, capsys):
    write_face_list("back.npy", np.array([1]), read_scene("scene").topology)
    assert "seen from the training angles 0" in refuse(TRAIN.replace("logo.npy", "back.npy") + "--angles 0", capsys)


def test_an_existing_run_folder(here, capsys):
    Path("run").mkdir()
    Path("run", "something").touch()
    assert "run: exists already" in refuse(TRAIN, capsys)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TETRAHEDRON.replace("v 1 0 0", "v nan 0 0"), "b.obj"),
        (TETRAHEDRON.replace("f 2 3 4\n", ""), "b.obj"),
        ("nothing", "b.obj"),
    ],
)
def test_a_damaged_or_foreign_obj_names_its_file(here, capsys, text, words):
    Path("b.obj").write_text(text)
    assert words in refuse("scene import a.obj b.obj --out new", capsys)
