"""Real files of ONNX, OpenVINO, TFLite and ultralytics: what each says of photographs its original or its twin says."""

import json
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.outcomes import class_name
from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.detectors.check import check_image, read_image
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family.model_file import read_model
from cloak_core.detectors.onnx_family.networks import Session
from cloak_core.detectors.pixels import fit
from cloak_core.detectors.verification import verify
from cloak_core.detectors.verification.comparing import apart
from cloak_core.studies.hardening.students import open_student

pytest.importorskip("onnx2torch", reason="pip install 'cloak-core[onnx]'")
pytestmark = pytest.mark.slow
TWINS = {
    "openvino:original/person-detection-retail-0013.xml": "onnx:person_detection_retail_0013.onnx@stretch",
    "tflite:original/pose_detection.tflite": "onnx:mediapipe_pose_detection.onnx@letterbox",
}


@pytest.mark.long
@pytest.mark.parametrize("spec", TWINS)
def test_says_what_its_onnx_twin_says(shared, spec: str) -> None:
    pytest.importorskip({"openvino": "openvino", "tflite": "ai_edge_litert"}[spec.partition(":")[0]])
    folder = shared / "data" / "detectors"
    detector, twin = (
        load_detector(":".join((one.split(":")[0], f"{folder}/{one.split(':')[1]}"))) for one in (spec, TWINS[spec])
    )
    twin.fill = detector.fill  # the original letterboxes in black
    assert not detector.differentiable and detector.person == 0
    for name in ("person", "kodim18", "max_Pilots"):
        image = read_image(next((shared / "data" / "photos").glob(f"{name}.*")))[None]
        with torch.no_grad():
            found, expected = detector(image), twin(image)
        difference = apart(found, expected, tuple(image.shape[2:]))
        assert difference.scores < 1e-5 and difference.boxes_px < 0.05, (name, difference)
    assert max_person_score(detector(read_image(shared / "data" / "photos" / "person.jpg")[None])).item() > 0.9


@pytest.mark.parametrize("spec", TWINS)
def test_keeps_what_a_detector_promises(shared, spec: str) -> None:
    family, _, name = spec.partition(":")
    pytest.importorskip({"openvino": "openvino", "tflite": "ai_edge_litert"}[family])
    report = verify(load_detector(f"{family}:{shared / 'data' / 'detectors' / name}"))
    assert report["failed"] == [], report["checks"]


@pytest.mark.long
def test_a_real_file_tells_what_else_it_sees(shared) -> None:
    detector = load_detector(f"onnx:{shared / 'data' / 'detectors' / 'yolov5n.onnx'}")
    with torch.no_grad():
        found = detector(read_image(shared / "data" / "photos" / "dog.jpg")[None])
    best, row = found.other[0].max(dim=0)
    assert best > 0.5 > found.scores.max()
    assert class_name(detector.class_names, int(found.other_class[0, row])) in ("dog", "bicycle", "car", "truck")
    # Names and the person's place stand in the JSON file beside it.
    other = load_detector(f"onnx:{shared / 'data' / 'detectors' / 'person_vehicle_bike_2000.onnx'}")
    assert other.person == 1 and other.class_names[0] == "vehicle"


@pytest.mark.long
@pytest.mark.parametrize("name", ["yolov5n", "ssd_mobilenet_v1", "fastestdet", "yolov8n", "nanodet_m"])
def test_a_real_file(shared, name: str) -> None:
    path = shared / "data" / "detectors" / f"{name}.onnx"
    detector = load_detector(f"onnx:{path}@stretch")
    assert detector.differentiable and not detector.network.one_by_one
    photos = shared / "data" / "photos"
    images = [fit(read_image(photos / f"{p}.jpg")[None], detector.input_size)[0] for p in ("person", "dog", "horses")]
    session = Session(read_model(path))
    with torch.no_grad():
        found = detector.answer(torch.cat(images))
        for i, image in enumerate(images):
            expected = detector.decode(session(image), detector.input_size)
            torch.testing.assert_close(found.boxes[i : i + 1], expected.boxes, atol=0.05, rtol=0)
            torch.testing.assert_close(found.classes[i : i + 1], expected.classes, atol=1e-4, rtol=0)
    described = json.loads(path.with_suffix(".json").read_text())["verified"]["photos"]["person.jpg"]["float"]
    # Another resampling than the one that the file was described with.
    assert check_image(detector, photos / "person.jpg")["max_person"] == pytest.approx(described, abs=0.05)


STRIDES, ANCHORS = (8, 16, 32), 3


@pytest.fixture
def pickle_file(shared) -> Path:
    """YOLOv5n as its authors pickled it."""
    if find_spec("ultralytics") is None:  # asked without importing it: what it patches would stay so
        pytest.skip("pip install 'cloak-core[ultralytics]' (AGPL-3.0)")
    return shared / "data" / "detectors" / "yolov5n.pt"


def anchors_last(rows: Float[Tensor, "N ..."], side: int) -> Float[Tensor, "N ..."]:
    """Rows that run over anchors, then cells, as rows that run over cells, then anchors: as the twin has them."""
    counts = [ANCHORS * (side // stride) ** 2 for stride in STRIDES]
    levels = rows.split(counts)
    return torch.cat([level.unflatten(0, (ANCHORS, -1)).transpose(0, 1).flatten(0, 1) for level in levels])


@pytest.mark.long
def test_the_original_pickle_is_its_onnx_twin(shared, pickle_file: Path) -> None:
    photos = sorted((shared / "data" / "photos").glob("*.jpg"))
    detector, twin = (
        load_detector(f"ultralytics:{pickle_file}"),
        load_detector(f"onnx:{pickle_file.with_suffix('.onnx')}"),
    )
    assert len(photos) == 6 and detector.person == 0 and detector.input_size == twin.input_size == (640, 640)
    for photo in photos:
        image = read_image(photo)[None]
        with torch.no_grad():
            found, expected = detector(image), twin(image)
        scores = anchors_last(found.scores[0], 640)
        torch.testing.assert_close(scores, expected.scores[0], atol=0.005, rtol=0)
        seen = expected.scores[0] > 0.25
        boxes = anchors_last(found.boxes[0], 640)
        torch.testing.assert_close(boxes[seen], expected.boxes[0][seen], atol=1.0, rtol=0.005)


def test_the_original_pickle_stretched(shared, pickle_file: Path) -> None:
    found = check_image(load_detector(f"ultralytics:{pickle_file}@stretch"), shared / "data" / "photos" / "person.jpg")
    assert found["max_person"] == pytest.approx(0.789, abs=0.05)  # of the twin, with another resampling


@pytest.mark.long
def test_the_original_pickle_is_written_again_with_other_numbers(pickle_file: Path, tmp_path) -> None:
    student = open_student(f"ultralytics:{pickle_file}@64")
    again = load_detector(student.write(student.network.state_dict(), tmp_path, 0))
    assert state_hash(again) == state_hash(student.teacher)  # its parameters are in half precision, and stay so
    with torch.no_grad():
        student.network.model[-1].m[0].bias += 1
    other = load_detector(student.write(student.network.state_dict(), tmp_path, 0))
    moved = other.network.model[-1].m[0].bias - again.network.model[-1].m[0].bias
    torch.testing.assert_close(moved, torch.ones_like(moved), atol=0.01, rtol=0)
