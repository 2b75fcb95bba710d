"""ONNX files as exporters and accidents leave them: what is read, what is said of the rest."""

import json
import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family import networks
from cloak_core.detectors.verification import verify
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images, lowers_score
from tests.detectors.test_onnx import FLOAT, SIDE, Made, close, onnx

INT = onnx.TensorProto.INT64


def test_an_operator_that_nobody_knows_is_named(tmp_path: Path) -> None:
    made = Made().finished()
    made.nodes[1].op_type = "Frobnicate"
    with pytest.raises(InputError, match=r"m\.onnx: not an ONNX model that onnxruntime can run .*Frobnicate"):
        load_detector(f"onnx:{made.save(tmp_path / 'm.onnx')}")


def tampered(folder: Path, change: Callable[[object], None]) -> Path:
    """A finished network whose first weights were changed in the file."""
    path = Made().finished().save(folder / "m.onnx")
    model = onnx.load(str(path))
    change(model.graph.initializer[0])
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize("extents", [{0: -8}, {0: -8, 1: -3}, {0: 1 << 40}])
def test_extents_over_which_onnxruntime_ends_the_process(extents: dict[int, int], tmp_path: Path) -> None:
    def change(tensor: object) -> None:
        for axis, extent in extents.items():
            tensor.dims[axis] = extent

    with pytest.raises(InputError, match=rf"m\.onnx: its tensor first declares a shape of {extents[0]}x"):
        load_detector(f"onnx:{tampered(tmp_path, change)}")


def test_a_path_of_weights_that_no_path_can_be(tmp_path: Path) -> None:
    def change(tensor: object) -> None:
        tensor.ClearField("raw_data")
        tensor.data_location = onnx.TensorProto.EXTERNAL
        tensor.external_data.add(key="location", value="a\0b")

    with pytest.raises(InputError, match=r"keeps weights in a\\x00b, outside its folder"):
        load_detector(f"onnx:{tampered(tmp_path, change)}")


def test_resize_to_sizes(tmp_path: Path) -> None:
    """By `sizes` it holds the batch that it was exported with."""
    made = Made()
    made.weight("sizes", np.array([1, 8, 16, 16]), INT)
    made.body()
    made.nodes[2].output[0] = made.nodes[2].name = "small"
    grid = made.nodes.pop()
    made.node("Resize", "small none none sizes", "active", mode="nearest", coordinate_transformation_mode="asymmetric")
    made.nodes[-1].input[1:3] = ["", ""]
    made.nodes.append(grid)
    made.head()
    detector = load_detector(f"onnx:{made.save(tmp_path / 'resize.onnx')}")
    assert detector.differentiable and detector(images(3, SIDE, SIDE)).scores.shape == (3, 256)
    close(detector)


def test_a_black_box_of_a_fixed_batch_is_asked_image_by_image(tmp_path: Path, caplog) -> None:
    made = Made()
    made.weight("fixed", np.array([1, 6, -1]), INT)
    made.body(grid="rough")
    made.node("Shrink", "rough", "grid", lambd=0.0)
    made.head("fixed")
    path = made.save(tmp_path / "m.onnx")
    with caplog.at_level(logging.WARNING):
        detector = load_detector(f"onnx:{path}")
    assert not detector.differentiable and detector.network.one_by_one
    batch = images(3, SIDE, SIDE)
    together = detector(batch).scores
    torch.testing.assert_close(together, torch.cat([detector(image).scores for image in batch.split(1)]))
    report = verify(detector, images(4, SIDE, SIDE))
    assert report["failed"] == [] and report["white_box"] is False
    assert report["gradient_error"] is None and report["parity_scores"] is None


def test_what_is_left_after_suppression_is_said(tmp_path: Path, caplog) -> None:
    made = Made().finished()
    made.node("Transpose", "boxes", "corners", perm=[0, 2, 1])
    for name, value in (("one", 1), ("two", 2), ("most", 20)):
        made.weight(name, np.array([value]), INT)
    made.weight("iou", np.array([0.5]))
    made.node("Slice", "scores one two axis", "people")
    made.node("NonMaxSuppression", "corners people most iou", "chosen")
    with caplog.at_level(logging.WARNING):
        detector = load_detector(f"onnx:{made.save(tmp_path / 'beside.onnx')}")
    assert "a black box" in caplog.text and "it suppresses boxes itself (node chosen)" in caplog.text
    assert not detector.differentiable
    next(node for node in made.nodes if node.name == "output").output[0] = "unused"
    made.node("Cast", "chosen", "output", to=FLOAT)
    made.nodes[-1].name = "cast"
    with pytest.raises(InputError, match=r"of no known layout; boxes are suppressed in it \(node chosen\).* export it"):
        load_detector(f"onnx:{made.save(tmp_path / 'm.onnx')}")


def heads(folder: Path, shape: list[int]) -> Path:
    """A network whose three outputs are a YOLO's raw heads for 2 classes, of strides 8, 16 and 32."""
    made, outputs = Made(), []
    for stride in (8, 16, 32):
        made.weight(f"w{stride}", np.random.default_rng(stride).normal(0, 0.1, (21, 3, stride, stride)))
        made.node("Conv", f"images w{stride}", f"grid{stride}", strides=[stride, stride])
        last = f"grid{stride}"
        if len(shape) == 5:
            made.weight(f"to{stride}", np.array([0, 3, 7, SIDE // stride, SIDE // stride]), INT)
            made.node("Reshape", f"{last} to{stride}", f"parts{stride}")
            made.node("Transpose", f"parts{stride}", f"head{stride}", perm=[0, 1, 3, 4, 2])
            last = f"head{stride}"
        outputs.append(last)
    path = made.save(folder / f"raw{len(shape)}.onnx")
    model = onnx.load(str(path))
    model.graph.output.pop()
    model.graph.output.extend(onnx.helper.make_tensor_value_info(name, FLOAT, None) for name in outputs)
    onnx.save(model, str(path))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("dimensions", [4, 5])
def test_raw_heads_of_yolo(dimensions: int, tmp_path: Path) -> None:
    path = heads(tmp_path, [0] * dimensions)
    with pytest.raises(InputError, match=r"a YOLO's raw heads, whose anchors the file does not say: yolov5-raw"):
        load_detector(f"onnx:{path}")
    detector = load_detector(f"onnx:{path}:yolov5-raw")
    assert detector(images(2, SIDE, SIDE)).scores.shape == (2, 3 * (64 + 16 + 4))
    assert verify(detector, images(4, SIDE, SIDE))["failed"] == []


def test_a_json_file_beside_it_says_names_person_and_more(tmp_path: Path) -> None:
    path = Made().finished().save(tmp_path / "m.onnx", names="")
    record = {
        "classes": {"0": "pedestrian", "1": "vehicle"},
        "person_class": 0,
        "confidence": 0.35,
        "input": {"channels": "BGR", "range": "[0, 255]", "normalisation": "folded into the graph"},
    }
    path.with_suffix(".json").write_text(json.dumps(record))
    detector = load_detector(f"onnx:{path}")
    assert detector.class_names == ("pedestrian", "vehicle") and detector.person == 0
    assert (detector.operating_point, detector.operating_point_assumed) == (0.35, False)
    assert (detector.pixels.bgr, detector.pixels.range, detector.pixels_assumed) == (True, 255.0, False)
    overridden = load_detector(f"onnx:{path}@rgb,range=255,person=vehicle,conf=0.5")
    assert overridden.person == 1 and not overridden.pixels.bgr and overridden.operating_point == 0.5


def test_a_loop_without_end_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """2^62 rounds."""
    make, truth = onnx.helper, onnx.TensorProto.BOOL
    kinds = {"i": INT, "c": truth, "x": FLOAT, "co": truth, "xo": FLOAT}
    ends = [make.make_tensor_value_info(name, kind, None if kind == FLOAT else []) for name, kind in kinds.items()]
    steps = [make.make_node("Identity", ["c"], ["co"]), make.make_node("Sin", ["x"], ["xo"])]
    made = Made()
    made.weight("rounds", np.array(1 << 62), INT)
    made.weight("true", np.array(True), truth)
    made.node("Loop", "rounds true images", "output", body=make.make_graph(steps, "body", ends[:3], ends[3:]))
    monkeypatch.setattr(networks, "SECONDS", 0.5)
    with pytest.raises(InputError, match=r"endless\.onnx: a network that takes more than 0\.5 s for an image"):
        load_detector(f"onnx:{made.save(tmp_path / 'endless.onnx')}")


def test_an_input_that_nobody_can_run_is_refused(tmp_path: Path) -> None:
    path = Made().finished().save(tmp_path / "huge.onnx", sides=("height", "width"), imgsz="[8192, 8192]")
    with pytest.raises(InputError, match=r"huge\.onnx: an input size of 8192x8192 is not possible"):
        load_detector(f"onnx:{path}")


@pytest.mark.parametrize("text", ["[1, 2]", "{", '{"classes": {"a": 1}, "person_class": true, "confidence": "high"}'])
def test_another_programs_json_is_left_alone(text: str, tmp_path: Path) -> None:
    path = Made().finished().save(tmp_path / "m.onnx")
    path.with_suffix(".json").write_text(text)
    detector = load_detector(f"onnx:{path}")
    assert detector.class_names == ("cat", "person") and detector.operating_point_assumed and detector.pixels_assumed


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
    made.finished(bias=bias)
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
