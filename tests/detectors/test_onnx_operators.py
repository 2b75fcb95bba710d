"""Operators of today's opsets, against onnxruntime."""

from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family.networks import NotConvertible, prepared, to_torch
from cloak_core.detectors.verification import verify
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images
from tests.detectors.test_onnx import SIDE, Made, onnx  # leaves this file out where onnx is not installed

onnxruntime = pytest.importorskip("onnxruntime")

helper = onnx.helper
NEWEST = 23
"""Opset that is tried."""


def model_of(operation: str, opset: int, outputs: int, constants: dict[str, np.ndarray], **attributes: object):
    """Make a graph of one operator that reads `x` and then constants; "" stands for an input that is left out."""
    tensors = [onnx.numpy_helper.from_array(values, name) for name, values in constants.items() if values is not None]
    inputs = [name if constants[name] is not None else "" for name in constants]
    answers = [f"y{i}" for i in range(outputs)]
    node = helper.make_node(operation, ["x", *inputs], answers, name="it", **attributes)
    graph = helper.make_graph(
        [node],
        "one",
        [helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [None] * 4)],
        [helper.make_empty_tensor_value_info(name) for name in answers],
        tensors,
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=10)


def ints(*values: int) -> np.ndarray:
    return np.array(values, np.int64)


def reals(*values: float) -> np.ndarray:
    return np.array(values, np.float32)


PLACES = np.random.default_rng(1).uniform(-1, 1, (2, 5, 5, 2)).astype(np.float32)
OPERATORS = {
    "the same, more types": ("Transpose", 23, 1, {}, {"perm": [0, 2, 3, 1]}),
    "an attribute that is new, as it was before": ("Cast", 19, 1, {}, {"to": onnx.TensorProto.FLOAT, "saturate": 1}),
    "sizes": ("Split", 18, 2, {"sizes": ints(1, 4)}, {"axis": 1}),
    "parts": ("Split", 18, 2, {}, {"axis": 1, "num_outputs": 2}),
    "one part": ("Split", 13, 1, {"sizes": ints(5)}, {"axis": 1}),
    "scales": ("Resize", 19, 1, {"roi": None, "scales": reals(1, 1, 2, 2)}, {"antialias": 0}),
    "axes as an input": ("ReduceMax", 20, 1, {"axes": ints(1, 2)}, {"keepdims": 0}),
    "all axes": ("ReduceMean", 18, 1, {}, {}),
    "pads": ("Pad", 19, 1, {"pads": ints(0, 0, 1, 2, 0, 0, 2, 1)}, {}),
    "no zero means an empty tensor": ("Reshape", 21, 1, {"shape": ints(2, -1)}, {"allowzero": 1}),
    "an upper bound": ("Clip", 13, 1, {"low": None, "high": np.float32(0.5)}, {}),
    "a lower bound": ("Clip", 13, 1, {"low": np.float32(0.5)}, {}),
    "another axis": ("Flatten", 21, 1, {}, {"axis": 2}),
    "an axis from the end": ("Flatten", 13, 1, {}, {"axis": -1}),
    "the first of equal ones": ("TopK", 11, 2, {"count": ints(2)}, {"axis": 1}),
    "tanh": ("Gelu", 20, 1, {}, {"approximate": "tanh"}),
    "unknown shape": ("LayerNormalization", 17, 1, {"scale": reals(1, 2, 3, 4, 5, 6)}, {"epsilon": 1e-3}),
    "old names": ("GridSample", 16, 1, {"grid": PLACES}, {"mode": "bilinear", "padding_mode": "border"}),
    "new names": ("GridSample", 22, 1, {"grid": PLACES}, {"mode": "linear", "align_corners": 1}),
}


@pytest.mark.parametrize("case", OPERATORS)
def test_answers_as_onnxruntime_does(case: str) -> None:
    operation, opset, outputs, constants, attributes = OPERATORS[case]
    model = model_of(operation, opset, outputs, constants, **attributes)
    x = np.random.default_rng(0).normal(0, 1, (2, 5, 4, 6)).astype(np.float32)
    x[1] = 0.25
    expected = onnxruntime.InferenceSession(model.SerializeToString()).run(None, {"x": x})
    found = to_torch(prepared(model))(torch.from_numpy(x))
    found = [found] if isinstance(found, torch.Tensor) else list(found)
    assert len(found) == len(expected)
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours, torch.from_numpy(theirs), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    ("operation", "constants", "attributes"),
    [
        ("Resize", {"roi": None, "scales": reals(1, 1, 0.5, 0.5)}, {"mode": "linear", "antialias": 1}),
        ("Pad", {"pads": ints(1, 1), "value": None, "axes": ints(2)}, {}),
        ("ReduceMax", {}, {"noop_with_empty_axes": 1}),
    ],
)
def test_what_is_new_and_used_is_named(operation: str, constants: dict, attributes: dict) -> None:
    with pytest.raises(NotConvertible, match=rf"no translation for {operation} of version 18 \(node it\)") as caught:
        prepared(model_of(operation, 18, 1, constants, **attributes))
    assert caught.value.untranslated == [{"op": operation, "version": 18, "node": "it"}]


def made(**spoilt: float) -> Made:
    """A network with what is new since opset 18, and a cast that is listed after its use."""
    made = Made()
    made.body(grid="rough")
    made.node("Split", "rough", "low high", axis=1, num_outputs=2)
    made.node("Concat", "low high", "grid", axis=1)
    made.head()
    made.node("Cast", "images", "cast", to=onnx.TensorProto.FLOAT)
    made.nodes[0].input[0] = "cast"
    return made


@pytest.mark.parametrize("opset", [18, NEWEST])
def test_a_file_of_today_is_a_white_box_whose_batch_goes_right(opset: int, tmp_path: Path) -> None:
    detector = load_detector(f"onnx:{made().save(tmp_path / 'm.onnx', opset=opset)}")
    assert detector.differentiable and not detector.network.one_by_one
    report = verify(detector, images(4, SIDE, SIDE))
    assert report["failed"] == [] and report["opset"] == opset and report["untranslated"] == []


def test_a_black_box_says_why_where_and_what_to_do(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    network = made()
    network.nodes[-2].output[0] = network.nodes[-2].name = "all"
    network.node("Shrink", "all", "output", lambd=0.0)
    detector = load_detector(f"onnx:{network.save(tmp_path / 'm.onnx', opset=18)}")
    why = "no translation for Shrink of version 9 (node output)"
    assert f"{why}; to train against it, export it with opset=17, or name the .pt" in caplog.text
    report = verify(detector, images(4, SIDE, SIDE))
    assert report["untranslated"] == [{"op": "Shrink", "version": 9, "node": "output"}]
    assert why in report["checks"]["parity"]["words"]


def test_an_opset_newer_than_the_installed_onnx_says_both_numbers(tmp_path: Path) -> None:
    newest = onnx.defs.onnx_opset_version()
    with pytest.raises(
        InputError, match=rf"is of opset {newest + 1}, the installed onnx .* knows opsets up to {newest}"
    ):
        load_detector(f"onnx:{made().save(tmp_path / 'm.onnx', opset=newest + 1)}")
