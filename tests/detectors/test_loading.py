"""Specs, class names, python modules, state hashes."""

from pathlib import Path

import pytest
import torch

from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from tests.detectors.helpers import TINY_CFG, images, write_tiny

MODULE = """
import torch
class Module(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.scale = torch.nn.Parameter(torch.tensor(1.0))
    def forward(self, images):
        b, _, h, w = images.shape
        boxes = torch.tensor([0.0, 0.0, w / 2, h]).expand(b, 1, 4)
        return boxes, images.mean((1, 2, 3))[:, None] * self.scale
def load():
    return Module()
class Viewing(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.register_buffer("kernel", torch.randn(4, 3, 3, 3, generator=torch.Generator().manual_seed(0)))
    def forward(self, images):
        self.strides = images.stride()
        scores = torch.conv2d(images, self.kernel).view(len(images), -1).sigmoid()
        return torch.zeros(*scores.shape, 4), scores
"""


@pytest.fixture
def module(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(MODULE)
    return path


def test_darknet_is_frozen_and_in_image_pixels(tmp_path: Path) -> None:
    detector = load_detector(write_tiny(tmp_path))
    assert detector.name == "tiny" and not detector.training
    assert not [p for p in detector.parameters() if p.requires_grad]
    small, large = detector(images(2, 64, 64)), detector(images(2, 128, 192))
    assert small.boxes.shape == (2, 2 * 8 * 8, 4) and small.objectness is not None and small.is_person is not None
    ratio = torch.tensor([3.0, 2.0, 3.0, 2.0])
    # The same picture at another size: the same boxes, scaled (bilinear up and down again is not quite the identity).
    torch.testing.assert_close(large.boxes / ratio, small.boxes, rtol=0, atol=2.0)
    torch.testing.assert_close(small.scores, small.objectness)


def test_letterbox_keeps_the_aspect_ratio(tmp_path: Path) -> None:
    detector = load_detector(write_tiny(tmp_path) + "@letterbox")
    wide = images(1, 64, 128)
    grey = torch.full((1, 3, 64, 64), 0.5)
    grey[:, :, 16:48] = torch.nn.functional.interpolate(wide, size=(32, 64), mode="bilinear", align_corners=True)
    inner = load_detector(write_tiny(tmp_path))(grey)
    outer = detector(wide)
    torch.testing.assert_close(outer.scores, inner.scores)
    torch.testing.assert_close(outer.boxes, (inner.boxes - torch.tensor([0.0, 16, 0, 16])) * 2)


def test_person_class_by_name_index_and_default(tmp_path: Path) -> None:
    cfg = TINY_CFG.replace("classes=1", "classes=2").replace("filters=12", "filters=14")
    spec = write_tiny(tmp_path, cfg, names=("cat", "Person"))
    both = load_detector(spec)(images()), load_detector(spec, person_class="cat")(images())
    torch.testing.assert_close(both[0].scores + both[1].scores, both[0].objectness)
    assert torch.equal(both[0].is_person, ~both[1].is_person)
    assert torch.equal(load_detector(spec, person_class="0")(images()).scores, both[1].scores)
    with pytest.raises(InputError, match=r"tiny.cfg: no class 'dog' among its 2 \(cat, Person\)"):
        load_detector(spec, person_class="dog")


def test_names_come_from_a_list_beside_the_cfg(tmp_path: Path) -> None:
    spec = write_tiny(tmp_path, names=None)
    with pytest.raises(InputError, match=r"names of its 1 classes are unknown; give @person="):
        load_detector(spec)
    assert load_detector(spec, person_class="0").name == "tiny"
    (tmp_path / "a.names").write_text("person\n")
    assert load_detector(spec).name == "tiny"
    (tmp_path / "b.names").write_text("dog\n")
    with pytest.raises(InputError, match=r"several .names files beside it list 1 classes"):
        load_detector(spec)
    with pytest.raises(InputError, match=r"tiny.names: 2 class names, but tiny.cfg has 1 classes"):
        load_detector(write_tiny(tmp_path, names=("person", "dog")))


def test_python_module(module: Path) -> None:
    detector = load_detector(f"python:{module}:load")
    assert detector.name == "mine" and not [p for p in detector.parameters() if p.requires_grad]
    batch = images(2, 40, 60).requires_grad_()
    found = detector(batch)
    assert found.boxes.tolist() == [[[0.0, 0.0, 30.0, 40.0]]] * 2
    max_person_score(found).sum().backward()
    assert batch.grad is not None and batch.grad.abs().sum() > 0
    resized = load_detector(f"python:{module}:load@32")(images(2, 40, 60))
    torch.testing.assert_close(resized.boxes, found.boxes)


def test_a_module_that_takes_views_gets_the_usual_memory_layout(module: Path) -> None:
    detector, plain = (load_detector(f"python:{module}:Viewing", fold=fold) for fold in (True, False))
    for _ in range(2):
        torch.testing.assert_close(detector(images(2, 40, 60)).scores, plain(images(2, 40, 60)).scores)
    assert detector.module.strides[1] == 40 * 60


def test_a_function_that_is_not_there(module: Path) -> None:
    with pytest.raises(InputError, match="has no function 'absent'"):
        load_detector(f"python:{module}:absent")


def test_state_hash_sees_everything(tmp_path: Path) -> None:
    spec = write_tiny(tmp_path)
    detector, twin = load_detector(spec), load_detector(spec)
    before = state_hash(detector)
    assert before == state_hash(twin) and len(before) == 64
    detector(images().requires_grad_()).scores.sum().backward()
    assert state_hash(detector) == before
    assert state_hash(twin.to(memory_format=torch.channels_last)) == before
    twin.network.layers[0].conv.weight[0, 0, 0, 0] += 1e-7
    assert state_hash(twin) != before
    detector.network.layers[0].train()
    assert state_hash(detector) != before


@pytest.mark.parametrize(("suffix", "cells"), [("", 8 * 8), ("@32", 4 * 4), ("@32x128", 4 * 16), ("@64,letterbox", 64)])
def test_size_in_the_spec(suffix: str, cells: int, tmp_path: Path) -> None:
    assert load_detector(write_tiny(tmp_path) + suffix)(images()).scores.shape == (2, 2 * cells)
    # What is said beside the spec wins.
    assert load_detector(write_tiny(tmp_path) + suffix, input_size=(32, 64))(images()).scores.shape == (2, 2 * 32)
