"""What exporters write today is trained against, hardened, and written back as it came."""

from importlib.util import find_spec
from pathlib import Path

import pytest

for package in ("onnx", "onnx2torch", "onnxruntime", "onnxscript", "onnxslim", "transformers"):
    pytest.importorskip(package, reason="pip install 'cloak-core[test]'")
from tests.detectors.exports import EXPORTS, LAYOUTS, judge  # noqa: E402

FEW = [("yolov8n", "ultralytics, default"), ("Yolos", "torch, legacy")]
LEFT_OUT = [row for row in EXPORTS if row[0].endswith(("_large", "_fpn"))]
"""They choose boxes by rules that have no gradient, in the middle of their graphs."""
LEFT_OUT += [(name, "torch, default") for name in ("RTDetrV2", "DFine")]
"""torch 2.14 does not export them."""
LEFT_OUT.append(("rtdetr-l", "ultralytics, half"))
"""Random weights, rounded: its answers in torch are 0.002 off onnxruntime's."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "row",
    [*FEW, *(pytest.param(row, marks=pytest.mark.long) for row in EXPORTS if row not in (*FEW, *LEFT_OUT))],
    ids=" ".join,
)
def test_a_file_of_today_is_a_white_box_and_hardened(row: tuple[str, str], tmp_path: Path) -> None:
    if (
        "yolo" in row[0] and find_spec("ultralytics") is None
    ):  # asked without importing it: what it patches would stay so
        pytest.skip("pip install 'cloak-core[ultralytics]' (AGPL-3.0)")
    path = tmp_path / "net.onnx"
    EXPORTS[row](path=path)
    judged = judge(path, LAYOUTS.get(row[0], ""))
    assert judged is None or (judged.white_box and judged.hardened), judged
