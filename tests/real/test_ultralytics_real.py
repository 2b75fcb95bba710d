"""The original YOLOv5n pickle says of photographs what its ONNX twin says."""

from importlib.util import find_spec

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.protocol import state_hash
from cloak_core.detectors.check import check_image, read_image
from cloak_core.detectors.loading import load_detector
from cloak_core.studies.hardening.students import open_student

# Asked without importing it: what it patches would stay so for the tests that follow.
if find_spec("ultralytics") is None:
    pytest.skip("pip install 'cloak-core[ultralytics]' (AGPL-3.0)", allow_module_level=True)
pytest.importorskip("onnx2torch", reason="pip install 'cloak-core[onnx]'")
pytestmark = pytest.mark.slow
STRIDES, ANCHORS = (8, 16, 32), 3


def anchors_last(rows: Float[Tensor, "N ..."], side: int) -> Float[Tensor, "N ..."]:
    """Rows that run over anchors, then cells, as rows that run over cells, then anchors: as the twin has them."""
    counts = [ANCHORS * (side // stride) ** 2 for stride in STRIDES]
    levels = rows.split(counts)
    return torch.cat([level.unflatten(0, (ANCHORS, -1)).transpose(0, 1).flatten(0, 1) for level in levels])


@pytest.mark.long
def test_the_original_pickle_is_its_onnx_twin(shared) -> None:
    folder, photos = shared / "data" / "detectors", sorted((shared / "data" / "photos").glob("*.jpg"))
    detector = load_detector(f"ultralytics:{folder / 'yolov5n.pt'}")
    twin = load_detector(f"onnx:{folder / 'yolov5n.onnx'}")
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


def test_the_original_pickle_stretched(shared) -> None:
    folder = shared / "data"
    detector = load_detector(f"ultralytics:{folder / 'detectors' / 'yolov5n.pt'}@stretch")
    found = check_image(detector, folder / "photos" / "person.jpg")
    assert found["max_person"] == pytest.approx(0.789, abs=0.05)  # of the twin, with another resampling


@pytest.mark.long
def test_the_original_pickle_is_written_again_with_other_numbers(shared, tmp_path) -> None:
    spec = f"ultralytics:{shared / 'data' / 'detectors' / 'yolov5n.pt'}@64"
    student = open_student(spec)
    again = load_detector(student.write(student.network.state_dict(), tmp_path, 0))
    assert state_hash(again) == state_hash(student.teacher)  # its parameters are in half precision, and stay so
    with torch.no_grad():
        student.network.model[-1].m[0].bias += 1
    other = load_detector(student.write(student.network.state_dict(), tmp_path, 0))
    moved = other.network.model[-1].m[0].bias - again.network.model[-1].m[0].bias
    torch.testing.assert_close(moved, torch.ones_like(moved), atol=0.01, rtol=0)
