"""torchvision's and ultralytics' detectors and modules of a file learn, and are written as what they were."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from torch import nn

from cloak_core.core.detector.protocol import state_hash
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from cloak_core.studies.hardening.answers import Surer
from cloak_core.studies.hardening.student import NAME
from cloak_core.studies.hardening.students import open_student
from tests.detectors.helpers import images
from tests.detectors.test_torchvision import Case
from tests.studies.hardening.made_students import (
    FEWER,
    check_that_a_stopped_one_goes_on,
    disturb,
    hardened,
    learns,
    losses_of,
)

EXAMPLE = Path(__file__).parents[3] / "examples" / "my_detector.py"
HERE = find_spec("ultralytics") is not None
ultralytics = pytest.mark.skipif(not HERE, reason="pip install 'cloak-core[ultralytics]' (AGPL-3.0)")
TORCHVISION = [
    "ssdlite320_mobilenet_v3_large",
    "fasterrcnn_mobilenet_v3_large_320_fpn",
    *(
        pytest.param(name, marks=pytest.mark.long)
        for name in ("fcos_resnet50_fpn", "retinanet_resnet50_fpn", "maskrcnn_resnet50_fpn", "ssd300_vgg16")
    ),
]
ULTRALYTICS = [
    pytest.param("yolov8n", marks=ultralytics),
    pytest.param("yolov5 original", marks=ultralytics),
    *(
        pytest.param(name, marks=[ultralytics, pytest.mark.long])
        for name in ("yolov8n.yaml", "yolov10n", "yolo26n", "yolov8n-seg")
    ),
]


@pytest.fixture
def spec(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A detector with random weights that tells images apart and is sure of some things."""
    name = request.param
    if name.startswith("yolo"):
        return f"ultralytics:{yolo(name, tmp_path, monkeypatch)}@64,person=1"
    # VGG's last maps are empty below SSD300's own size.
    return f"torchvision:{name}:{Case(name, tmp_path).path}@{300 if name == 'ssd300_vgg16' else 64},person=1"


def yolo(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    from cloak_core.detectors.ultralytics_family.architecture import build, read_architecture, settle_batch_norm
    from tests.detectors.test_ultralytics_files import original

    path = folder / "best.pt"
    if name.endswith(".yaml"):
        return name
    if name.endswith("original"):
        torch.save({"model": original(monkeypatch), "ema": None, "optimizer": None}, path)
        for module in ("models", "models.yolo", "models.common"):
            monkeypatch.delitem(sys.modules, module)
        return str(path)
    model = build(read_architecture(f"{name}.yaml") | {"nc": 3}, name)
    settle_batch_norm(model)
    with torch.no_grad():
        for branch in (getattr(model.model[-1], part, ()) for part in ("cv3", "one2one_cv3")):
            for classes in branch:
                classes[-1].weight *= 30
                classes[-1].bias.zero_()
    model.names = {0: "cat", 1: "person", 2: "dog"}
    torch.save({"model": model.half(), "ema": None, "train_args": {"imgsz": 64}}, path)
    return str(path)


@pytest.mark.long
@pytest.mark.parametrize("spec", [*TORCHVISION, *ULTRALYTICS], indirect=True)
def test_a_student_learns_what_its_teacher_says_and_is_written_as_its_like(spec: str, tmp_path: Path) -> None:
    student, batch = open_student(spec), images(2, 64, 64)
    rows, teacher = torch.tensor([0, 1, 0]), state_hash(student.teacher)
    wanted, shown = student.wanted(batch, rows), batch[rows]
    before = student.distance(shown, wanted).abs().max()
    assert float(before) < 1e-2

    disturb(student)
    statistics = [m.running_mean.clone() for m in student.network.modules() if isinstance(m, nn.BatchNorm2d)]
    each = student.distance(shown, wanted)
    assert each.shape == (3,) and torch.allclose(each[0], each[2], rtol=1e-3)
    losses = losses_of(student, shown, wanted)
    # A network fresh from its .yaml is sure of nothing (scores of 1e-5): there is nothing that it could forget.
    assert ".yaml" in spec or (losses[0] > 10 * before and losses[-1] < 0.95 * losses[0])
    after = [m.running_mean for m in student.network.modules() if isinstance(m, nn.BatchNorm2d)]
    assert all(torch.equal(*pair) for pair in zip(statistics, after, strict=True))
    assert state_hash(student.teacher) == teacher

    (tmp_path / "out").mkdir()
    written = student.write(student.network.state_dict(), tmp_path / "out", 0)
    again, own, was = load_detector(written)(batch), student.detector(batch), student.teacher(batch)
    half = spec.startswith("ultralytics") and ".yaml" not in spec and "best" in spec  # the precision of the file
    near = {"atol": 2e-3, "rtol": 0.02} if half else {"atol": 1e-4, "rtol": 1e-3}
    torch.testing.assert_close(again.scores, own.scores, **near)
    if ".yaml" not in spec:  # of such a one the scores are too small to tell
        off, learned = (float((one.scores.sum(1) - own.scores.sum(1)).abs().max()) for one in (again, was))
        assert off < 0.5 * learned
    licence = (tmp_path / "out" / f"{NAME}.licence.txt").read_text()
    assert written in licence and ("AGPL-3.0" if "ultralytics" in spec else "BSD-3-Clause") in licence


@pytest.mark.slow
@pytest.mark.parametrize("spec", [TORCHVISION[0], ULTRALYTICS[0]], indirect=True)
def test_another_picture_is_far_and_a_reported_person_is_to_be_surer(spec: str) -> None:
    student, batch = open_student(spec), images(2, 64, 64)
    wanted = student.wanted(batch, torch.arange(2))
    near, far = student.distance(batch, wanted), student.distance(batch.flip(0), wanted)
    assert float(far.min()) > 100 * float(near.abs().max())
    assert float(student.teacher(batch).scores[0].max()) > student.detector.operating_point
    surer = student.distance(batch, wanted, Surer(torch.tensor([True, False]), 0.9))
    assert float(surer[0]) > 1 and torch.equal(surer[1], near[1])


@pytest.mark.long
@pytest.mark.parametrize("spec", [TORCHVISION[0], ULTRALYTICS[0]], indirect=True)
def test_a_stopped_hardening_goes_on_to_the_same_bits(
    spec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_that_a_stopped_one_goes_on(spec, tmp_path, monkeypatch)


@pytest.mark.slow
def test_official_checkpoints_batch_norm_is_told_by_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "ssdlite320_mobilenet_v3_large"
    monkeypatch.setattr("cloak_core.detectors.torchvision_family.EPS_ZERO", {name})
    student = open_student(f"torchvision:{name}:random@64")
    for eps in (0.0, 1e-3):
        for m in student.network.modules():
            if isinstance(m, nn.BatchNorm2d):
                m.eps = eps
        again = load_detector(student.write(student.network.state_dict(), tmp_path, 0), fold=False)
        found = {m.eps for m in again.modules() if isinstance(m, nn.BatchNorm2d)}
        assert found == ({0.0} if eps == 0 else {1e-3})


@pytest.mark.slow
@pytest.mark.parametrize("spec", ULTRALYTICS[:1], indirect=True)
def test_the_package_reads_what_was_made_of_its_file(spec: str, tmp_path: Path) -> None:
    from cloak_core.detectors.ultralytics_family.architecture import library

    student = open_student(spec.replace("@64,person=1", "@person=dog"))
    disturb(student)
    written = student.write(student.network.state_dict(), tmp_path, 0)
    assert written == f"ultralytics:{tmp_path}/{NAME}.pt@person=dog"
    again, batch = load_detector(written), images(1, 64, 64)
    assert (again.person, again.input_size) == (2, (64, 64))
    with library():
        content = torch.load(tmp_path / f"{NAME}.pt", weights_only=False)
    theirs = content["model"].float().eval()
    assert theirs.names[2] == "dog" and content["train_args"] == {"imgsz": 64}
    torch.testing.assert_close(theirs(batch)[0][:, 4 + 2], again(batch).scores, atol=1e-5, rtol=2e-3)


def test_a_python_module_whose_weights_are_out_of_reach_is_refused(tmp_path: Path) -> None:
    (tmp_path / "box.py").write_text(
        "import torch\n"
        "class Box(torch.nn.Module):\n"
        "    def forward(self, x):\n"
        "        return torch.zeros(len(x), 1, 4), x.mean((1, 2, 3))[:, None]\n"
        "def load():\n    return Box()\n"
    )
    with pytest.raises(InputError, match="its module has no parameters that torch could train"):
        open_student(f"python:{tmp_path}/box.py:load")


def test_a_python_module_learns_and_is_loaded_again(tmp_path: Path) -> None:
    spec = f"python:{EXAMPLE}:load"
    learns(open_student(spec))
    result = hardened(spec, tmp_path / "out", **FEWER)
    assert result.spec == f"python:{tmp_path}/out/hardened.py:load"
    batch = images(1)
    before, after = load_detector(spec)(batch).scores, load_detector(result.spec)(batch).scores
    assert not torch.equal(before, after)
    torch.testing.assert_close(before, after, atol=0.3, rtol=0)
