"""The verification kit on real detectors, photographs and renders."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.verification import verify
from cloak_core.detectors.verification.kit import natural_size
from cloak_core.studies.clean import sample_images
from tests.real.test_detectors_real import spec_of

REAL = ["builtin", "yolo-fastest-xl", "d2go", "fastestdet", "yolov5n"]
LONG = {"yolov5n"}


def spec(name: str, shared: Path) -> str:
    if name == "builtin":
        return name
    file = shared / "data" / "detectors" / f"{name}.onnx"
    if not file.is_file():
        return spec_of(name, shared)
    if find_spec("onnx2torch") is None:
        pytest.skip("pip install 'cloak-core[onnx]'")
    return f"onnx:{file}"


@pytest.mark.long
@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long) if n in LONG else n for n in REAL])
def test_real_detectors_keep_what_they_promise(name: str, shared: Path) -> None:
    detector = load_detector(spec(name, shared))
    report = verify(detector, sample_images(natural_size(detector), shared / "data" / "photos", 2))
    assert report["failed"] == [] and report["white_box"] and report["images"] == 8
    assert (report["parity_scores"] is None) == (name == "d2go")
    assert report["gradient_error"] < (0.5 if name == "d2go" else 0.1)
