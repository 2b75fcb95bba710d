"""Files of ultralytics and of the original YOLOv5 as people have them: read, or refused in one line; and the package
does nothing else to the process or the world."""

import copy
import json
import os
import subprocess
import sys
import types
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from torch import nn

from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images, lowers_score

# Asked without importing it: what it patches would stay so for the tests that follow.
if find_spec("ultralytics") is None:
    pytest.skip("pip install 'cloak-core[ultralytics]' (AGPL-3.0)", allow_module_level=True)

from cloak_core.detectors.ultralytics_family.architecture import build, library

ANCHORS = torch.tensor([[[10.0, 13], [16, 30]], [[30, 61], [62, 45]]])
STRIDES = torch.tensor([4.0, 8.0])
DESCRIPTION = {
    "nc": 3,
    "depth_multiple": 0.33,
    "width_multiple": 0.25,
    "anchors": [[10, 13, 16, 30], [30, 61, 62, 45]],
    "backbone": [
        [-1, 1, "Conv", [64, 6, 2, 2]],
        [-1, 1, "Conv", [64, 3, 2]],
        [-1, 3, "C3", [64]],
        [-1, 1, "Conv", [128, 3, 2]],
        [-1, 1, "SPPF", [128, 5]],
    ],
    "head": [[[2, 4], 1, "Detect", ["nc", "anchors"]]],
    "ch": 3,
}


class Foreign(nn.Module):
    """A module whose class the reading side does not have."""


def foreign(module: nn.Module, place: str, name: str, monkeypatch: pytest.MonkeyPatch) -> nn.Module:
    """The module as an instance of PLACE.NAME, which is importable while the test lasts."""
    holder = sys.modules.get(place) or types.ModuleType(place)
    monkeypatch.setitem(sys.modules, place, holder)
    if "." in place:
        monkeypatch.setitem(sys.modules, place.split(".")[0], types.ModuleType(place.split(".")[0]))
    kind = getattr(holder, name, None) or type(name, (type(module),), {"__module__": place})
    setattr(holder, name, kind)
    module.__class__ = kind
    return module


def original(monkeypatch: pytest.MonkeyPatch, description: dict = DESCRIPTION) -> nn.Module:
    """A model as the original YOLOv5 pickles it: its body, under a head of one convolution for each stride."""
    body = build(copy.deepcopy(description) | {"head": [[*description["head"][0][:3], ["nc"]]]}, "test").model
    torch.manual_seed(1)
    for m in body.modules():
        if isinstance(m, nn.BatchNorm2d):
            m.running_mean.uniform_(-0.1, 0.1)
            m.running_var.uniform_(0.02, 0.05)
            m.eps = 0.002
        if type(m).__module__.startswith("ultralytics"):
            foreign(m, "models.common", type(m).__name__, monkeypatch)
    head = foreign(Foreign(), "models.yolo", description["head"][-1][2], monkeypatch)
    head.m = nn.ModuleList(nn.Conv2d(c, 2 * (5 + 3), 1) for c in (16, 32))
    for conv in head.m:
        conv.weight.data *= 0.05
    head.register_buffer("anchors", ANCHORS / STRIDES[:, None, None])
    head.stride = STRIDES
    body[-1] = head
    model = foreign(Foreign(), "models.yolo", "Model", monkeypatch)
    model.model, model.yaml, model.stride, model.names = body, description, STRIDES, ["cat", "person", "dog"]
    return model


def by_hand(model: nn.Module, batch: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Boxes and person scores of the original, number by number."""
    x, kept = batch, []
    for layer in list(model.model.eval())[:-1]:
        x = layer(x)
        kept.append(x)
    boxes, scores = [], []
    for feature, conv, anchors, stride in zip((kept[2], kept[4]), model.model[-1].m, ANCHORS, STRIDES, strict=True):
        raw = conv(feature)[0]
        for a, anchor in enumerate(anchors):
            for row in range(raw.shape[1]):
                for column in range(raw.shape[2]):
                    x, y, w, h, objectness, *classes = raw[a * 8 : a * 8 + 8, row, column].sigmoid()
                    centre = torch.stack([2 * x - 0.5 + column, 2 * y - 0.5 + row]) * stride
                    side = torch.stack([(2 * w) ** 2, (2 * h) ** 2]) * anchor
                    boxes.append(torch.cat([centre - side / 2, centre + side / 2]))
                    scores.append(objectness * classes[1])
    return torch.stack(boxes), torch.stack(scores)


@pytest.mark.slow
def test_an_original_yolov5(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "v5.pt"
    model = original(monkeypatch)
    torch.save({"model": model, "ema": None, "optimizer": None}, path)
    for name in ("models", "models.yolo", "models.common"):
        monkeypatch.delitem(sys.modules, name)
    detector = load_detector(f"ultralytics:{path}@32x48")
    assert detector.person == 1 and not [m for m in detector.modules() if isinstance(m, nn.BatchNorm2d)]
    batch = images(2, 32, 48)
    with torch.no_grad():
        found, (boxes, scores) = detector(batch), by_hand(model, batch[:1])
    torch.testing.assert_close(found.boxes[0], boxes, atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(found.scores[0], scores, atol=1e-5, rtol=1e-3)
    assert found.objectness is not None and bool((found.objectness >= found.scores).all())
    assert found.is_person is not None and 0 < found.is_person.sum() < found.is_person.numel()
    before, after = lowers_score(detector, batch)
    assert bool((after < before).all())


@pytest.mark.slow
def test_pickles_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    description = copy.deepcopy(DESCRIPTION)
    description["head"][-1][2] = "IDetect"
    model = original(monkeypatch)
    model.yaml = description
    torch.save({"model": model}, tmp_path / "v7.pt")
    with pytest.raises(InputError, match=r"models\.yolo\.Model with the head IDetect; of such pickles only original"):
        load_detector(f"ultralytics:{tmp_path / 'v7.pt'}")
    torch.save({"model": foreign(Foreign(), "elsewhere.models", "Net", monkeypatch)}, tmp_path / "v.pt")
    with pytest.raises(InputError, match=r"the pickle holds elsewhere\.models\.Net, which is never loaded"):
        load_detector(f"ultralytics:{tmp_path / 'v.pt'}")


class Evil:
    def __reduce__(self) -> tuple:
        return os.system, ("touch ran",)


def small(**changes: object) -> nn.Module:
    with library() as tasks:
        description = {"nc": 2, "backbone": [[-1, 1, "Conv", [8, 3, 2]]], "head": [[[0], 1, "Detect", ["nc"]]]}
        model = tasks.DetectionModel(description, verbose=False)
    for name, value in changes.items():
        setattr(model, name, value)
    return model


@pytest.mark.slow
def test_checkpoints_that_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def refused(content: object, words: str) -> None:
        if content is not None:
            torch.save(content, "a.pt")
        with pytest.raises(InputError, match=words):
            load_detector("ultralytics:a.pt@32,person=0")
        assert not Path("ran").exists()

    model = small()
    refused({"model": model, "note": Evil()}, r"a\.pt: the pickle holds (posix|nt)\.system, which is never loaded")
    refused(model.state_dict(), "a state dict alone, which does not say what network it is for")
    refused({"model": model.state_dict()}, "a state dict alone")
    refused({"model": None, "epoch": 3}, "no checkpoint of ultralytics or YOLOv5")
    refused([1, 2], "no checkpoint of ultralytics")
    refused({"model": small(yaml=None)}, "carries no description of its network")
    refused({"model": small(yaml=model.yaml | {"nc": 3})}, r"does not fit the model: \d+ tensors of another shape")
    refused({"model": small(yaml=model.yaml | {"head": [[[0], 1, "OBB", [2, 1]]]})}, "its head is OBB")
    broken = small()
    broken.model[0].conv.weight.data[0] = float("nan")
    refused({"model": broken}, r"model\.0\.conv\.weight holds numbers that are not finite")
    refused({"model": small(yaml={"nc": 2, "backbone": 3, "head": []})}, "describes no network")
    endless = small()
    endless.model[0]._modules["again"] = endless
    refused({"model": endless}, "modules inside modules without end")
    with zipfile.ZipFile("a.pt", "w") as archive:
        archive.writestr("x/constants.pkl", b"")
    refused(None, "a TorchScript archive")
    torch.save({"model": model}, "a.pt")
    Path("a.pt").write_bytes(Path("a.pt").read_bytes()[:-400])
    refused(None, "not a whole file of torch.save")
    Path("a.pt").unlink()
    refused(None, "a.pt: no such file")


ALONE = """
import json, os, signal, socket, sys, warnings
def refuse(*a, **k):
    raise AssertionError("reached for the network")
import cv2, numpy, PIL.Image, torch
socket.socket.__init__ = socket.getaddrinfo = socket.create_connection = socket.gethostbyname = refuse
cv2.setNumThreads(2); torch.set_num_threads(1); numpy.set_printoptions(precision=3)
def state():
    return dict(
        signals=[signal.getsignal(s) for s in signal.Signals], threads=(torch.get_num_threads(), cv2.getNumThreads()),
        opens=PIL.Image.open, saves=torch.save, filters=list(warnings.filters), hook=sys.excepthook,
        prints=(str(numpy.get_printoptions()), str(torch._tensor_str.PRINT_OPTS)), out=sys.stdout,
        random=torch.get_rng_state().sum().item(), dtype=torch.get_default_dtype(),
        environment={k: v for k, v in os.environ.items() if not k.startswith(("YOLO_", "ULTRALYTICS_"))},
    )
from cloak_core.detectors.families import list_families
from cloak_core.detectors.loading import load_detector
list_families()
assert "ultralytics" not in sys.modules
before = state()
for what in sys.argv[1:]:
    detector = load_detector("ultralytics:" + what)
    images = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0), requires_grad=True)
    detector(images).scores.sum().backward()
    assert images.grad.isfinite().all()
after = state()
assert {k for k in before if before[k] != after[k]} == set(), [k for k in before if before[k] != after[k]]
import logging
logging.getLogger("ultralytics").error("spoken")
import ultralytics.utils as u
print(json.dumps({"online": u.ONLINE, "settings": str(u.SETTINGS_FILE), "modules": "ultralytics" in sys.modules}))
"""


@pytest.mark.long
def test_it_reaches_no_network_and_leaves_the_process_as_it_was(tmp_path: Path) -> None:
    torch.save({"model": small(names=["person", "cat"])}, tmp_path / "a.pt")
    home = tmp_path / "home"
    ours = ("YOLO_", "ULTRALYTICS_", "XDG_", "OMP_")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
    environment = kept | {"HOME": str(home), "CLOAK_CACHE": str(tmp_path / "cache")}
    root = Path(__file__).parents[2]
    environment |= {"PYTHONPATH": str(root), "MPLCONFIGDIR": str(tmp_path)}
    wanted = [f"{tmp_path / 'a.pt'}@64", "yolov10n.yaml@64", "yolov8n-rtdetr.yaml@64"]
    run = subprocess.run(
        [sys.executable, "-c", ALONE, *wanted], capture_output=True, text=True, env=environment, cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
    report = json.loads(run.stdout)  # and not a word beside it
    assert report["online"] is False and Path(report["settings"]).is_relative_to(tmp_path / "cache")
    assert "spoken" in run.stderr
    assert not [path for path in home.rglob("*") if "ltralytics" in path.name]


@pytest.mark.slow
def test_an_activation_that_the_package_no_longer_builds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = original(monkeypatch)
    model.model[0].act = nn.Hardswish()
    torch.save({"model": model}, tmp_path / "old.pt")
    with pytest.raises(InputError, match=r"model\.0\.act is Hardswish in the file, SiLU in .*: written by a version"):
        load_detector(f"ultralytics:{tmp_path / 'old.pt'}")
