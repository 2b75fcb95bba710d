"""A run goes on only with what it was started with, by content; what moves its last bits is said."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.events import read_events
from cloak_core.core.run_config import read_config
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.trainings import run_record
from tests.core.test_training import run as box_run
from tests.detectors.helpers import TINY_CFG, write_tiny

MODULE = """
import torch
from near import GAIN
class Mean(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.tensor(1.0))
    def forward(self, images):
        scores = (GAIN * self.weight * images.mean((1, 2, 3)))[:, None].sigmoid()
        return torch.zeros(len(images), 1, 4) + scores[..., None], scores
def make():
    return Mean()
"""


def run(out: Path, detector: Detector, resume: bool = True, **material: object):
    return box_run(out, [detector], resume=resume, steps=2, checkpoint_every=1, preview_every=0, **material)


def python_detector(folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    folder.mkdir()
    (folder / "mine.py").write_text(MODULE)
    (folder / "near.py").write_text("GAIN = 2.0\n")
    monkeypatch.syspath_prepend(folder)
    return f"python:{folder / 'mine.py'}:make"


@pytest.mark.slow
@pytest.mark.parametrize("edited", ["mine.py", "near.py"])
def test_a_python_detector_that_was_edited_is_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, edited: str
) -> None:
    spec = python_detector(tmp_path / "code", monkeypatch)
    run(tmp_path / "run", load_detector(spec))
    run(tmp_path / "run", load_detector(spec))
    file = tmp_path / "code" / edited
    file.write_text(file.read_text().replace("2.0", "3.0").replace(".sigmoid()", ".sigmoid() ** 2"))
    with pytest.raises(InputError, match=r"run: was started with detectors\[0\]\.source\.file = [0-9a-f]{64}, not"):
        run(tmp_path / "run", load_detector(spec))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cfg", "options", "what"),
    [
        (TINY_CFG.replace("activation=leaky", "activation=relu"), "", "cfg"),
        (TINY_CFG, "@96", "input_size"),
        (TINY_CFG, "@letterbox", "letterbox"),
    ],
    ids=["another activation", "another input size", "letterbox"],
)
def test_a_darknet_detector_of_the_same_weights_run_otherwise_is_another(
    tmp_path: Path, cfg: str, options: str, what: str
) -> None:
    spec = write_tiny(tmp_path)
    run(tmp_path / "run", load_detector(spec))
    (tmp_path / "tiny.cfg").write_text(cfg)
    changed = load_detector(spec + options)
    assert detector_record(changed)["sha256"] == detector_record(load_detector(spec))["sha256"]
    with pytest.raises(InputError, match=rf"detectors\[0\]\.source\.{what}.* = .*, not"):
        run(tmp_path / "run", changed)


@pytest.mark.slow
def test_where_a_detector_lies_and_what_its_cfg_remarks_say_nothing(tmp_path: Path) -> None:
    first, second = load_detector(write_tiny(tmp_path)), tmp_path / "elsewhere"
    second.mkdir()
    spec = write_tiny(second, "# the same\n" + TINY_CFG.replace("filters=8", "filters = 8"))
    run(tmp_path / "run", first)
    assert run(tmp_path / "run", load_detector(spec)).step == 2
    assert detector_record(load_detector(spec)) == detector_record(first)


def picture(folder: Path, name: str, seed: int, **options: object) -> None:
    folder.mkdir(exist_ok=True)
    small = np.random.default_rng(seed).integers(0, 255, (6, 8, 3)).astype(np.uint8)
    Image.fromarray(small).resize((120, 90)).save(folder / name, **options)


@pytest.mark.slow
def test_backgrounds_saved_anew_are_the_same_and_others_are_not(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    detector, first, second = load_detector(write_tiny(tmp_path)), tmp_path / "first", tmp_path / "second"
    for i in range(2):
        picture(first, f"{i}.png", i)
        picture(second, f"{i} copy.png", i, compress_level=1)
    before = run(tmp_path / "run", detector, backgrounds=load_backgrounds(first, (64, 64)), resume=False)
    after = run(tmp_path / "again", detector, backgrounds=load_backgrounds(second, (64, 64)), resume=False)
    assert np.array_equal(before.colors, after.colors)
    assert run(tmp_path / "run", detector, backgrounds=load_backgrounds(second, (64, 64))).step == 2
    picture(second, "1 copy.png", 7)
    with pytest.raises(InputError, match=r"backgrounds\.identities\[1\]"):
        run(tmp_path / "run", detector, backgrounds=load_backgrounds(second, (64, 64)))
    # A version before this one knew pictures by their files.
    recorded = read_config(tmp_path / "run")
    recorded["backgrounds"] = {"count": 2, "identities": recorded["backgrounds"]["files"]}
    (tmp_path / "run" / "config.json").write_text(json.dumps(recorded))
    assert run(tmp_path / "run", detector, backgrounds=load_backgrounds(first, (64, 64))).step == 2
    with pytest.raises(InputError, match=r"backgrounds\.identities\[0\]"):
        run(tmp_path / "run", detector, backgrounds=load_backgrounds(second, (64, 64)))


def test_other_code_and_packages_are_said_and_not_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    detector, path = load_detector(write_tiny(tmp_path)), tmp_path / "run"
    run(path, detector)
    assert "changes" not in read_events(path / "events.jsonl")[0]
    recorded = json.loads((path / "config.json").read_text())
    assert len(recorded["code"]) == 64
    recorded["environment"]["torch"] = "1.0"
    recorded["detectors"][0]["packages"] = {"onnxruntime": "1.1"}
    (path / "config.json").write_text(json.dumps(recorded))
    detector.packages = ("onnxruntime",)
    monkeypatch.setattr(run_record, "code_hash", lambda *rooms: "other")
    with caplog.at_level(logging.WARNING, "cloak"):
        run(path, detector)
    (line,) = [record.getMessage() for record in caplog.records if "began with" in record.getMessage()]
    for word in (str(path), "other code", "torch 1.0 instead of", "onnxruntime 1.1 instead of", "bits"):
        assert word in line
    changes = [event["changes"] for event in read_events(path / "events.jsonl") if "changes" in event]
    assert len(changes) == 1 and len(changes[0]) == 3
