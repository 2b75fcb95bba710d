"""End-to-end exports: boxes and scores are read before the graph chooses its best, and a gradient reaches them all."""

import logging
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.verification import verify
from tests.detectors.helpers import images, lowers_score

onnx = pytest.importorskip("onnx", reason="pip install 'cloak-core[onnx]'")
pytest.importorskip("onnxruntime", reason="pip install 'cloak-core[onnx]'")
pytest.importorskip("onnx2torch", reason="pip install 'cloak-core[onnx]'")
from tests.detectors.test_onnx import SIDE, Made  # noqa: E402

INT = onnx.TensorProto.INT64
KEPT = 5
"""Boxes that the small export chooses, of 64."""


def end_to_end(path: Path, scale: float = 1.0, bias: str = "bias") -> Path:
    """Save a network that answers [N, 5, 6]: YOLOv10's choice by TopK, first of boxes, then of boxes and classes.

    scale: of boxes, after they are chosen.
    """
    made = Made()
    if bias == "copied":
        made.node("Identity", "bias", "copied")
    made.body(bias=bias)
    made.head()
    made.nodes.pop()  # the joined output
    for name, values in {"k": [KEPT], "last": [2], "two": [2]}.items():
        made.weight(name, np.array(values), INT)
    made.weight("span", np.array([16.0]))
    made.weight("least", np.array([0.0, 0, 40, 40]))
    made.weight("scale", np.array(scale))
    made.node("Transpose", "boxes", "offsets", perm=[0, 2, 1])
    made.node("Sigmoid", "offsets", "parts")
    made.node("Mul", "parts span", "spans")
    made.node("Add", "spans least", "corners")
    made.node("Transpose", "scores", "classes", perm=[0, 2, 1])
    made.node("ReduceMax", "classes", "best", axes=[-1], keepdims=0)
    made.node("TopK", "best k", "top index")
    made.node("Unsqueeze", "index last", "column")
    for kept, data, width in (("these", "classes", 2), ("places", "corners", 4)):
        made.weight(f"wide{width}", np.array([1, 1, width]), INT)
        made.node("Expand", f"column wide{width}", f"index{width}")
        made.node("GatherElements", f"{data} index{width}", kept, axis=1)
    made.node("Flatten", "these", "spread")
    made.node("TopK", "spread k", "score number")
    made.node("Mod", "number two", "kind")
    made.node("Div", "number two", "row")
    made.node("Unsqueeze", "row last", "rows1")
    made.node("Expand", "rows1 wide4", "rows4")
    made.node("GatherElements", "places rows4", "chosen", axis=1)
    made.node("Mul", "chosen scale", "scaled")
    made.node("Unsqueeze", "score last", "score1")
    made.node("Unsqueeze", "kind last", "kind1")
    made.node("Cast", "kind1", "kind2", to=onnx.TensorProto.FLOAT)
    made.node("Concat", "scaled score1 kind2", "output", axis=2)
    return made.save(path)


@pytest.mark.parametrize("bias", ["bias", "copied"])
def test_all_boxes_are_read_and_trained_against(bias: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = end_to_end(tmp_path / "e.onnx", bias=bias)
    detector = load_detector(f"onnx:{path}")
    assert not caplog.records and detector.differentiable and not detector.partial_gradient
    assert detector.source["layout"] == "end2end" and detector.class_names == ("cat", "person")
    batch = images(3, SIDE, SIDE)
    found = detector(batch)
    assert found.scores.shape == (3, 64) and found.other.shape == (3, 64)
    before, after = lowers_score(detector, batch)
    assert bool((after < before).all())
    inputs = batch[:1].requires_grad_()
    (slope,) = torch.autograd.grad(detector(inputs).scores.sort().values[0, 0], inputs)  # of a box that is not chosen
    assert float(slope.abs().max()) > 0
    assert verify(detector, images(4, SIDE, SIDE))["failed"] == []


def suppressing(path: Path, scale: float = 1.0, least: float = 0.0, first: int = 0) -> Path:
    """Save a network that answers [1, n, 6]: the rows of all boxes, suppressed.

    scale: of boxes after that; least: score below which they are left out; first: bias of the upper left corners.
    """
    made = Made().finished()
    made.nodes[-1].output[0] = made.nodes[-1].name = "columns"
    for name, values in {"none": [0], "two": [2], "three": [3], "most": [KEPT], "all": [6]}.items():
        made.weight(name, np.array(values), INT)
    made.weight("bias", np.array([first, first, 20, 20, -1, -1.0]))
    made.weights.pop(2)  # the bias that stood there
    made.weight("iou", np.array([0.5]))
    made.weight("least", np.array([least]))
    made.weight("scale", np.array(scale))
    made.node("Transpose", "columns", "all_rows", perm=[0, 2, 1])
    made.node("Slice", "all_rows none cut two", "corners")
    made.node("Slice", "all_rows cut all two", "classes")
    made.node("ReduceMax", "classes", "best", axes=[-1])
    made.node("Transpose", "best", "flat_best", perm=[0, 2, 1])
    made.node("NonMaxSuppression", "corners flat_best most iou least", "chosen")
    made.node("Slice", "chosen two three axis", "column")
    made.node("Squeeze", "column axis", "index")
    made.node("ArgMax", "classes", "kind", axis=-1)
    made.node("Cast", "kind", "kind_real", to=onnx.TensorProto.FLOAT)
    made.node("Mul", "corners scale", "scaled")
    made.node("Concat", "scaled best kind_real", "answers", axis=2)
    made.node("Gather", "answers index", "output", axis=1)
    return made.save(path, batch=1)


def test_boxes_are_read_before_their_suppression(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    detector = load_detector(f"onnx:{suppressing(tmp_path / 'n.onnx')}")
    assert not caplog.records and detector.differentiable and detector.source["layout"] == "end2end"
    batch = images(2, SIDE, SIDE)
    assert detector(batch).scores.shape == (2, 64) and bool(torch.lt(*lowers_score(detector, batch)[::-1]).all())
    assert not load_detector(f"onnx:{suppressing(tmp_path / 'n.onnx', scale=2.0)}").differentiable


@pytest.mark.parametrize(("first", "read"), [(-90, True), (30, False)])
def test_where_nothing_is_reported_corners_must_stand_in_their_order(first: int, read: bool, tmp_path: Path) -> None:
    path = suppressing(tmp_path / "n.onnx", least=1.0, first=first)
    assert load_detector(f"onnx:{path}").differentiable is read


def test_what_changes_boxes_after_the_choice_is_read_as_the_file_answers(tmp_path: Path, caplog) -> None:
    with caplog.at_level(logging.WARNING):
        detector = load_detector(f"onnx:{end_to_end(tmp_path / 'e.onnx', scale=2.0)}")
    assert "only the boxes that the file chooses have a gradient" in caplog.text
    assert detector.differentiable and "chooses" in detector.partial_gradient
    found = detector(images(2, SIDE, SIDE))
    assert found.scores.shape == (2, KEPT) and detector.source["layout"] == "end2end"
