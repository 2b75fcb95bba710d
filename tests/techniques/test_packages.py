"""A technique and a pattern of another package: named by the caller alone, recorded, refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from cloak_core import cli
from cloak_core.core.events import read_events
from cloak_core.core.logo import load_logo
from cloak_core.files.errors import InputError
from cloak_core.files.specs import reach
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies.opening import open_pattern

CODE = """
import contextlib
from pathlib import Path
import numpy as np
from cloak_core.core.technique import Technique
from cloak_core.patterns.cloth import ClothPattern
Path(__file__).with_name("ran").touch()

class Grey(Technique):
    def __init__(self, least):
        self.least = least
    name = "darkness"
    def penalty(self, colors):
        return 2.0, 1 - colors.mean()
    def project(self, colors):
        return colors.mean(1, keepdim=True).clamp(min=self.least).expand(-1, 3)
    def report(self, colors):
        return {"least": float(colors.min())}
    @contextlib.contextmanager
    def detector_context(self, number, step):
        with Path("asked").open("a") as file:
            print(number, step, file=file)
        yield

def grey(text, settings, pattern, detectors, device):
    return Grey(float(text or 0))

def halves(text, cover, bodies):
    picture = np.zeros((2, 2, 3), np.uint8)
    picture[0] = 255
    return ClothPattern.of_picture(cover, picture, float(text), bodies=bodies)

def nothing(*arguments):
    return None
"""
POINTS = """
[cloak.techniques]
grey = made_elsewhere:grey
nothing = made_elsewhere:nothing
gone = made_elsewhere:gone
twice = made_elsewhere:grey

[cloak.patterns]
halves = made_elsewhere:halves
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of an installed package `made-elsewhere`, and of another one that has one of its names, too."""
    folder = tmp_path / "site"
    for name, points in {"made_elsewhere": POINTS, "other": "[cloak.techniques]\ntwice = other:grey\n"}.items():
        about = folder / f"{name}-1.5.dist-info"
        about.mkdir(parents=True)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.5\n")
        (about / "entry_points.txt").write_text(points)
    (folder / "made_elsewhere.py").write_text(CODE)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.chdir(tmp_path)
    return folder


def train(*more: str) -> int:
    words = "train --scene sample:train[0] --logo chest --backgrounds procedural:train:2 --out run --steps 2 --batch 2"
    words += " --size 64 --samples 1 --translation 5 --threads 1 --angles 0 --checkpoint-every 1 --json"
    with pytest.raises(SystemExit) as end:
        cli.main([*words.split(), *more])
    return end.value.code or 0


@pytest.mark.slow
def test_a_technique_acts_and_the_run_goes_on_with_it_alone(package: Path, capsys):
    assert train("--technique", "grey:0.75", "--black-box-queries", "64") == 2
    assert "a --technique that projects" in capsys.readouterr().err and not Path("run").exists()
    assert train("--technique", "grey:0.75", "--max-seconds", "1e-6") == 3
    (record,) = json.loads(Path("run/config.json").read_text())["techniques"]
    assert record | {"sha256": ""} == {"spec": "grey:0.75", "package": "made_elsewhere 1.5", "sha256": ""}
    assert json.loads(capsys.readouterr().out)["least"] >= 0.75
    event = next(event for event in read_events(Path("run/events.jsonl")) if event["type"] == "step")
    assert event["loss"] == pytest.approx(event["disappearance"] + 2.5 * event["tv"] + 2 * event["darkness"])
    assert Path("asked").read_text() == "0 0\n"
    for other in ([], ["--technique", "grey:0.5"]):
        assert train("--resume", *other) == 2
        assert "techniques" in capsys.readouterr().err
    assert train("--resume", "--technique", "grey:0.75") == 0
    colors = np.load("run/colors.npy")
    assert (colors == colors[:, :1]).all() and colors.min() >= 0.75


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("gray", "no installed package has an entry point 'gray' of group cloak.techniques (known: gone, grey,"),
        ("twice", "several packages have an entry point 'twice'"),
        ("grey:much", "made_elsewhere:grey: ValueError: could not convert"),
        ("nothing", "must return a Technique, it returned NoneType"),
        ("gone", "AttributeError: module 'made_elsewhere' has no attribute 'gone'"),
    ],
)
def test_what_cannot_be_had_is_one_line(spec: str, words: str, package: Path, capsys):
    assert train("--technique", spec) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert words in said and said.count("cloak:") == 1 and not Path("run").exists()


def test_no_settings_file_brings_a_technique(package: Path, capsys):
    Path("settings.toml").write_text('technique = ["grey"]\n')
    assert train("--config", "settings.toml") == 2
    assert "no such setting" in capsys.readouterr().err and not (package / "ran").exists()


def test_a_pattern_is_worn_by_the_name_that_its_package_gives_it(package: Path):
    cover = load_logo(sample_bodies(), "chest")
    pattern, training, name = open_pattern("pattern:halves:0.3", cover)
    assert (
        training is None and name == "pattern:halves:0.3" and pattern.cover.key == cover.key and pattern.period == 0.3
    )
    turned, _, _ = open_pattern("pattern:halves:0.3@flipped", cover)
    assert (turned.colors.reshape(2, 2, 3)[0] == 0).all()
    assert reach("pattern:halves:0.3") == "runs code"
    with pytest.raises(InputError, match=r"half: .*cloak\.patterns \(known: halves\)"):
        open_pattern("pattern:half")
