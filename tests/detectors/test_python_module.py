"""Detectors that people write themselves, and what goes wrong in them: one line with the spec and the file's line."""

from pathlib import Path

import pytest
import torch

from cloak_core.core.detector.protocol import detector_record, state_hash
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError

SOUND = """
import sys
import torch

class Mine(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.register_buffer("count", torch.zeros(1))

    def forward(self, images):
        boxes = torch.zeros(len(images), 1, 4)
        scores = images.mean(dim=(1, 2, 3))[:, None]
        return boxes, scores

def load():
    return Mine()
"""
FORWARD, SCORES = 10, 12
"""Lines of it."""


def detector(folder: Path, old: str = "", new: str = ""):
    assert old in SOUND
    (folder / "mine.py").write_text(SOUND.replace(old, new) if old else SOUND)
    return load_detector(f"python:{folder / 'mine.py'}:load")


VIEWS = """
class Mine(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.register_buffer("kernel", torch.randn(4, 3, 3, 3, generator=torch.Generator().manual_seed(0)))

    def forward(self, images):
        self.strides = images.stride()
        scores = torch.conv2d(images, self.kernel).view(len(images), -1).sigmoid()
        width, height = images.shape[3], images.shape[2]
        return torch.tensor([0.0, 0.0, width / 2, height]).expand(*scores.shape, 4), scores
"""


@pytest.mark.parametrize("at", ["", "@32"])
def test_it_sees_pixels_in_the_usual_order_and_boxes_come_back_to_the_images_size(tmp_path: Path, at: str) -> None:
    (tmp_path / "mine.py").write_text(f"import torch\n{VIEWS}")
    made, plain = (load_detector(f"python:{tmp_path / 'mine.py'}:Mine{at}", fold=fold) for fold in (True, False))
    batch = torch.rand(2, 3, 40, 60, generator=torch.Generator().manual_seed(0), requires_grad=True)
    for _ in range(2):
        found = made(batch)
        torch.testing.assert_close(found.scores, plain(batch).scores)
    assert made.name == "mine" and made.module.strides[1] == (32 * 32 if at else 40 * 60)
    torch.testing.assert_close(found.boxes[:, 0], torch.tensor([[0.0, 0.0, 30.0, 40.0]] * 2))
    found.scores.sum().backward()
    assert batch.grad.abs().sum() > 0 and not [p for p in made.parameters() if p.requires_grad]
    with pytest.raises(InputError, match="has no function 'absent'"):
        load_detector(f"python:{tmp_path / 'mine.py'}:absent")


def test_it_may_tell_what_else_it_sees(tmp_path: Path) -> None:
    told = "Detections(boxes, scores, other=1 - scores, other_class=(0 * scores).long())"
    lines = SOUND.replace("return boxes, scores", f"return {told}").replace(
        "import torch\n", "import torch\nfrom cloak_core.core.detector.protocol import Detections\n", 1
    )
    (tmp_path / "mine.py").write_text(lines.replace("__init__()\n", "__init__()\n        self.class_names = ['dog']\n"))
    told = load_detector(f"python:{tmp_path / 'mine.py'}:load")
    found = told(images())
    assert told.class_names == ("dog",) and torch.equal(found.other, 1 - found.scores)
    (tmp_path / "mine.py").write_text(lines.replace(", other_class=(0 * scores).long()", ""))
    with pytest.raises(InputError, match="both of other and other_class"):
        load_detector(f"python:{tmp_path / 'mine.py'}:load")(images())


def images(count: int = 2) -> torch.Tensor:
    return torch.rand(count, 3, 8, 8, generator=torch.Generator().manual_seed(0), requires_grad=True)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("scores = images", "raise RuntimeError('two\\nlines'); scores = images", SCORES, "RuntimeError: two$"),
        ("images.mean", "images.detach().mean", FORWARD, "its scores carry no gradient"),
        ("scores = images", "self.count += 1; scores = images", FORWARD, "changes its own parameters or buffers"),
        (", scores\n", ", torch.rand(2, 1) + 0 * scores\n", FORWARD, "asked twice about the same images: best scores"),
        (", scores\n", ", scores / len(images)\n", FORWARD, "sees an image alone and among others: best scores"),
    ],
)
def test_what_running_it_runs_into(tmp_path: Path, old: str, new: str, line: int, words: str) -> None:
    made = detector(tmp_path, old, new)
    with pytest.raises(InputError, match=rf"python:.*mine\.py:load: .*mine\.py:{line}: .*{words}"):
        made(images())


def test_scores_and_state_that_go_wrong_later_are_found_at_the_end(tmp_path: Path) -> None:
    late = detector(tmp_path, "[:, None]\n", "[:, None] * (5 if images.mean() > 0.9 else 1)\n")
    before = state_hash(late)
    late(images(2))
    late.verify(before)
    late(0 * images(1) + 1)
    with pytest.raises(InputError, match=r"scores must lie in \[0, 1\]"):
        late.verify(before)
    changing = detector(tmp_path, "scores = images", "self.count += len(images) - 2; scores = images")
    before = state_hash(changing)
    with torch.no_grad():
        changing.module.count.add_(1)
    with pytest.raises(InputError, match="changed its own parameters"):
        changing.verify(before)


READS = {
    "a name": "json.load(open(pathlib.Path(__file__).parent / 'data' / 'inner.json'))",
    "its own name": "json.load(open(pathlib.Path(__file__).with_suffix('.json')))",
    "a name that is put together": "json.load(open(pathlib.Path(__file__).parent / ('sc' + 'ale.' + 'json')))",
    "a relative path": "json.load(open('./' + 'sc' + 'ale.json'))",
}


@pytest.mark.parametrize("read", READS)
def test_data_beside_it_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    places = [tmp_path / "data" / "inner.json", tmp_path / "mine.json", tmp_path / "scale.json"]
    (tmp_path / "bystander.json").write_text("1")

    def record(value: int) -> dict:
        for place in places:
            place.write_text(str(value))
        reads = f"import sys, json, pathlib\nSCALE = {READS[read]}\n"
        return detector_record(detector(tmp_path, "import sys\n", reads))

    before = record(1)
    assert set(before["source"]) == {"file", "function", "input_size", "letterbox", "data"}
    assert record(1) == before and list(before["source"]["data"]) == [
        {"a name": "data/inner.json", "its own name": "mine.json"}.get(read, "scale.json")
    ]
    assert record(2) != before
    (tmp_path / "bystander.json").write_text("2")
    assert record(1) == before
