"""Bad input through the command line: one line that names the thing, exit code 2, nothing written or lost."""

import re
from pathlib import Path

import numpy as np
import pytest

from cloak_core import cli
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.face_lists import write_face_list
from cloak_core.exchange.scenes import write_scene

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
        ("scene import net.cfg --out new", "net.cfg"),
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
        ("scene info absent", "absent: no such scene"),
        ("scene info x --nonsense", "--nonsense"),
        ("scene import absent.obj --out x", "absent.obj"),
        ("nonsense", "unknown command 'nonsense'"),
        ("scene nonsense", "unknown command 'scene nonsense'"),
    ],
)
def test_one_line_names_the_thing(here, capsys, line, words):
    assert re.search(words, refuse(line, capsys))


def test_an_existing_run_folder(here, capsys):
    Path("run").mkdir()
    Path("run", "something").touch()
    assert "run: exists already" in refuse(TRAIN, capsys)
