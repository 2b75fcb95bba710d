"""Files as OpenVINO's and MediaPipe's users have them, against their ONNX twins."""

import pytest
import torch

from cloak_core.core.detector.outcomes import class_name
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.detectors.check import read_image
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.verification import verify
from cloak_core.detectors.verification.comparing import apart

pytestmark = pytest.mark.slow
TWINS = {
    "openvino:original/person-detection-retail-0013.xml": "onnx:person_detection_retail_0013.onnx@stretch",
    "tflite:original/pose_detection.tflite": "onnx:mediapipe_pose_detection.onnx@letterbox",
}


@pytest.mark.long
@pytest.mark.parametrize("spec", TWINS)
def test_says_what_its_onnx_twin_says(shared, spec: str) -> None:
    pytest.importorskip({"openvino": "openvino", "tflite": "ai_edge_litert"}[spec.partition(":")[0]])
    pytest.importorskip("onnx2torch", reason="pip install 'cloak-core[onnx]'")
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
    pytest.importorskip("onnx2torch", reason="pip install 'cloak-core[onnx]'")
    detector = load_detector(f"onnx:{shared / 'data' / 'detectors' / 'yolov5n.onnx'}")
    with torch.no_grad():
        found = detector(read_image(shared / "data" / "photos" / "dog.jpg")[None])
    best, row = found.other[0].max(dim=0)
    assert best > 0.5 > found.scores.max()
    assert class_name(detector.class_names, int(found.other_class[0, row])) in ("dog", "bicycle", "car", "truck")
    # Names and the person's place stand in the JSON file beside it.
    other = load_detector(f"onnx:{shared / 'data' / 'detectors' / 'person_vehicle_bike_2000.onnx'}")
    assert other.person == 1 and other.class_names[0] == "vehicle"
