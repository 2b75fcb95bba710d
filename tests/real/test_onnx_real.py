"""Real detectors of today as ONNX files: they train, and say of photographs what onnxruntime says."""

import json

import pytest
import torch

from cloak_core.detectors.check import check_image, read_image
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family.model_file import read_model
from cloak_core.detectors.onnx_family.networks import Session
from cloak_core.detectors.pixels import fit

pytest.importorskip("onnx2torch", reason="pip install 'cloak-core[onnx]'")
pytestmark = pytest.mark.slow


LARGE = [pytest.param(name, marks=pytest.mark.long) for name in ("yolov8n", "nanodet_m")]


@pytest.mark.long
@pytest.mark.parametrize("name", ["yolov5n", "ssd_mobilenet_v1", "fastestdet", *LARGE])
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
    said = json.loads(path.with_suffix(".json").read_text())["verified"]["photos"]["person.jpg"]["float"]
    # Another resampling than the one that the file was described with.
    assert check_image(detector, photos / "person.jpg")["max_person"] == pytest.approx(said, abs=0.05)
