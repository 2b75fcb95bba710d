"""ultralytics' networks as detectors: what they say is what the package says, and it can be trained against."""

import copy
import functools
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from torch import nn

from cloak_core.core.detector.protocol import detector_record, state_hash
from cloak_core.detectors.classes import COCO
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images, lowers_score, others_are_the_rest

# Asked without importing it: what it patches would stay so for the tests that follow.
if find_spec("ultralytics") is None:
    pytest.skip("pip install 'cloak-core[ultralytics]' (AGPL-3.0)", allow_module_level=True)

from cloak_core.detectors.ultralytics_family.architecture import build, fuse, read_architecture, settle_batch_norm
from cloak_core.detectors.ultralytics_family.heads import DenseHead


def long(*names: str) -> list:
    return [pytest.param(name, marks=pytest.mark.long) for name in names]


MOST = long("yolov5n", "yolov9t", "yolo11n", "yolo12n", "yolo26n")
FAMILIES = ["yolov8n", "yolov10n", "yolov8n-rtdetr", *MOST]
OTHERS = long("yolov8n-seg", "yolo26n-pose", "yolov8n-p6")
TWO_HEADED = ["yolov10n", *long("yolo26n")]
SIDE = 64
NAMES = {0: "cat", 1: "person", 2: "dog"}


@functools.cache
def made(name: str, classes: int) -> nn.Module:
    model = build(read_architecture(f"{name}.yaml") | {"nc": classes}, name)
    settle_batch_norm(model)
    return model


def lively(name: str, classes: int = 80) -> nn.Module:
    """A network of the package itself that looks at its images."""
    return copy.deepcopy(made(name, classes))


def save(model: nn.Module, path: Path, **more: object) -> Path:
    """As the package saves its checkpoints: whole models, in half precision."""
    torch.save({"model": copy.deepcopy(model).half(), "ema": None, "date": "2026", **more}, path)
    return path


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A YOLOv8 of three classes, trained at 96 pixels."""
    model = lively("yolov8n", 3)
    model.names = NAMES
    return save(model, tmp_path_factory.mktemp("small") / "best.pt", train_args={"imgsz": 96})


def corners(boxes: torch.Tensor) -> torch.Tensor:
    return torch.cat([boxes[..., :2] - boxes[..., 2:] / 2, boxes[..., :2] + boxes[..., 2:] / 2], dim=-1)


def said(model: nn.Module, batch: torch.Tensor, person: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Boxes and person scores of the package's own forward, before its choice of the best."""
    with torch.no_grad():
        output, raw = model(batch)
    if isinstance(raw, tuple):  # RT-DETR
        return corners(raw[0][0]) * batch.shape[-1], raw[1][0].sigmoid()[..., person]
    rows = (output[0] if isinstance(output, tuple) else output).transpose(1, 2)
    return corners(rows[..., :4]), rows[..., 4 + person]


@pytest.mark.long
@pytest.mark.parametrize("of", ["description", "file"])
@pytest.mark.parametrize("name", [*FAMILIES, *OTHERS])
def test_says_what_the_package_says(name: str, of: str, tmp_path: Path) -> None:
    """In a file without names, 80 classes are COCO's, and one of a pose network is a person."""
    side, model = 2 * SIDE if "p6" in name else SIDE, lively(name, 1 if "pose" in name and of == "file" else 80)
    torch.save({"model": model}, tmp_path / "a.pt")
    detector = load_detector(f"ultralytics:{tmp_path / 'a.pt' if of == 'file' else name + '.yaml'}@{side}")
    batch = images(3, side, side)
    boxes, scores = said(model, batch, 0)
    with torch.no_grad():
        found = detector(batch)
    count = boxes.shape[1]
    assert found.scores.shape[1] == count * (2 if name.startswith(("yolov10", "yolo26")) else 1)
    torch.testing.assert_close(found.boxes[:, :count], boxes, atol=2e-3, rtol=1e-3)
    torch.testing.assert_close(found.scores[:, :count], scores, atol=1e-5, rtol=2e-3)
    assert found.objectness is None and bool((found.scores >= 0).all()) and bool((found.scores <= 1).all())
    assert not [m for m in detector.modules() if isinstance(m, nn.BatchNorm2d)]
    one = [detector(image) for image in batch.split(1)]
    torch.testing.assert_close(found.scores, torch.cat([o.scores for o in one]), atol=1e-5, rtol=1e-3)
    torch.testing.assert_close(found.boxes, torch.cat([o.boxes for o in one]), atol=2e-3, rtol=1e-3)


@pytest.mark.long
def test_tells_the_best_other_class(small: Path) -> None:
    assert load_detector(f"ultralytics:{small}").class_names == ("cat", "person", "dog")
    assert load_detector(f"ultralytics:yolov8n.yaml@{SIDE}").class_names == COCO
    others_are_the_rest(lambda number: load_detector(f"ultralytics:{small}@person={number}"), 3, 1, images(2, 90, 60))


@pytest.mark.slow
@pytest.mark.parametrize("name", TWO_HEADED)
def test_the_second_half_is_the_one_to_one_head(name: str) -> None:
    model, batch = lively(name), images(2, SIDE, SIDE)
    with torch.no_grad():  # make the two heads differ, as training does
        for classes in model.model[-1].one2one_cv3:
            classes[-1].bias += 2
    model.model[-1].end2end = True
    with torch.no_grad():
        best = model(batch)[0]  # x1, y1, x2, y2, score, class: after the choice of the best
        model.model[-1] = DenseHead(model.model[-1])
        found = model.model[-1].decode(model(batch))
    half = found.boxes.shape[1] // 2
    scores, number = found.classes[:, half:].amax(dim=-1).max(dim=1)
    torch.testing.assert_close(scores, best[:, 0, 4])
    box = found.boxes[:, half:][torch.arange(2), number]
    torch.testing.assert_close(box, best[:, 0, :4], atol=1e-3, rtol=1e-4)
    assert bool((found.classes[:, :half].amax(dim=(1, 2)) < scores).all())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["yolov8n", *long("yolov10n", "yolov8n-rtdetr"), *MOST])
def test_a_gradient_step_lowers_the_score(name: str) -> None:
    detector = load_detector(f"ultralytics:{name}.yaml@{SIDE}").double()
    hashed = state_hash(detector)
    before, after = lowers_score(detector, images(2, 80, 60).double(), 0.2)
    assert bool((after < before).all()) and state_hash(detector) == hashed


@pytest.mark.slow
def test_a_checkpoint(small: Path, tmp_path: Path) -> None:
    detector = load_detector(f"ultralytics:{small}")
    (tmp_path / "other.pt").write_bytes(small.read_bytes())
    record = detector_record(detector)
    assert record == detector_record(load_detector(f"ultralytics:{tmp_path / 'other.pt'}"))
    assert record["packages"]["ultralytics"] == version("ultralytics")
    assert detector.person == 1 and detector.input_size == (96, 96) and detector.name == "best"
    assert detector.operating_point == 0.25 and detector.operating_point_assumed and detector.letterbox
    batch = images(2, 96, 96)
    model = lively("yolov8n", 3).half().float()  # as the file has rounded it
    boxes, scores = said(model, batch, 1)
    with torch.no_grad():
        found = detector(batch)
    torch.testing.assert_close(found.boxes, boxes, atol=2e-3, rtol=1e-3)
    torch.testing.assert_close(found.scores, scores, atol=1e-5, rtol=2e-3)
    assert not detector.training and not [p for p in detector.parameters() if p.requires_grad]


def test_a_description_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(
        "nc: 2\nactivation: nn.ReLU()\nbackbone:\n  - [-1, 1, Conv, [16, 3, 2]]\n  - [-1, 1, Conv, [32, 3, 2]]\n"
        "  - [-1, 1, Conv, [64, 3, 2]]\nhead:\n  - [[2], 1, Detect, [nc]]\n"
    )
    detector = load_detector(f"ultralytics:{path}@64,person=1")
    assert detector(images(1)).scores.shape == (1, 64)
    assert [m for m in detector.modules() if isinstance(m, nn.ReLU)]


@pytest.mark.long
def test_the_averaged_model_counts(small: Path, tmp_path: Path) -> None:
    content = torch.load(small, weights_only=False)
    content["ema"], content["model"] = content["model"], copy.deepcopy(content["model"])
    for parameter in content["model"].parameters():
        parameter.data.zero_()
    torch.save(content, tmp_path / "mid.pt")
    detector, expected = (load_detector(f"ultralytics:{path}") for path in (tmp_path / "mid.pt", small))
    torch.testing.assert_close(detector(images(1)).scores, expected(images(1)).scores)


@pytest.mark.slow
def test_a_file_whose_batch_norm_was_folded_already(small: Path, tmp_path: Path) -> None:
    model = lively("yolov8n", 3).half().float()
    fuse(model)
    torch.save({"model": model}, tmp_path / "fused.pt")
    batch, expected = images(2, 96, 96), load_detector(f"ultralytics:{small}")
    found = load_detector(f"ultralytics:{tmp_path / 'fused.pt'}@96,person=1")(batch)
    torch.testing.assert_close(found.scores, expected(batch).scores, atol=1e-6, rtol=1e-3)


BAD = {
    "nc: [": "not YAML",
    "nc: 2\nbackbone: []\nhead: []": "describes no network",
    "nc: 2\nbackbone: [[-1, 1, Conv, [8, 3, 2]]]\nhead: [[[0], 1, Classify, [nc]]]": "its head is Classify",
    "nc: 2\nbackbone: [[-1, 1, YAML, [8]]]\nhead: [[[0], 1, Detect, [nc]]]": "a layer 'YAML', which is none",
    "nc: 2\nbackbone: [[-1, 1, DetectionModel, [http://a/b.yaml]]]\nhead: [[[0], 1, Detect, [nc]]]": "a layer 'Detec",
    "nc: 2\nbackbone: [[-1, 1, TorchVision, [512, resnet18]]]\nhead: [[[0], 1, Detect, [nc]]]": "fetches weights",
    "nc: 2\nbackbone: [[-1, 9999, Conv, [8]]]\nhead: [[[0], 1, Detect, [nc]]]": "more than is taken here",
    "nc: 2\nbackbone: [[-1, 1, Conv, [99999999]]]\nhead: [[[0], 1, Detect, [nc]]]": "more than is taken here",
    "nc: 2\nbackbone: [[-1, 9, C2f, [9999]]]\nhead: [[[0], 1, Detect, [nc]]]": "more parameters than any",
    "nc: 2\nbackbone: [[-1, 1, Concat, [8, 3, 2]]]\nhead: [[[0], 1, Detect, [nc]]]": "cannot be built",
    "nc: 2\nactivation: __import__('os')\nbackbone: [[-1, 1, Conv, [8]]]\nhead: [[[0], 1, Detect, [nc]]]": "an activa",
    "nc: 2\nch: 4\nbackbone: [[-1, 1, Conv, [8]]]\nhead: [[[0], 1, Detect, [nc]]]": "takes 4 channels",
    "backbone: [[-1, 1, Conv, [8]]]\nhead: [[[0], 1, Detect, [nc]]]": "no number of classes",
}


@pytest.mark.parametrize("text", BAD)
def test_descriptions_that_are_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=BAD[text]):
        load_detector(f"ultralytics:{path}@64")


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("yolov8n.yaml@100", r"an input of 100x100 is not a multiple of 32"),
        ("yolov99n.yaml", r"no such file, and ultralytics has none of that name \(near: yolov"),
        ("yolo11-cls-resnet18.yaml", "a layer TorchVision, which fetches weights"),
        ("yolov8n.yaml@64,person=unicorn", "no class 'unicorn' among its 80"),
        ("yolov8n.yaml@bgr", "bgr, range, mean and std are for onnx:FILE"),
        ("yolov8n.onnx", r"expected a checkpoint \(.pt\) or a description \(.yaml\)"),
        ("https://example.org/yolov8n.pt", "expected ultralytics:FILE"),
        ("yolov8n.pt", "yolov8n.pt: no such file"),
    ],
)
def test_bad_specs(spec: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        load_detector(f"ultralytics:{spec}")
