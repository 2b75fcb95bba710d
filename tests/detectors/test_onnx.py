"""ONNX files as detectors: converted and checked against onnxruntime, run image by image, or left a black box."""

import logging
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.core.detector.protocol import detector_record
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family.detector import OnnxDetector
from cloak_core.detectors.onnx_family.model_file import read_model
from cloak_core.detectors.onnx_family.networks import Session
from cloak_core.detectors.verification import comparing
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images, lowers_score, others_are_the_rest

onnx = pytest.importorskip("onnx", reason="pip install 'cloak-core[onnx]'")
pytest.importorskip("onnxruntime", reason="pip install 'cloak-core[onnx]'")
pytest.importorskip("onnx2torch", reason="pip install 'cloak-core[onnx]'")
helper, numpy_helper = onnx.helper, onnx.numpy_helper

SIDE = 64
NAMES = "{0: 'cat', 1: 'person'}"
FLOAT, HALF = onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT16


class Made:
    """A small network in YOLOv8's layout: two convolutions, SiLU between them, boxes and scores of an 8 x 8 grid."""

    def __init__(self, kind: int = FLOAT) -> None:
        self.kind, self.nodes, self.weights = kind, [], []
        random = np.random.default_rng(3)
        self.weight("first", random.normal(0, 0.2, (8, 3, 8, 8)))
        self.weight("second", random.normal(0, 0.3, (6, 8, 3, 3)))
        self.weight("bias", np.array([30, 30, 20, 20, -1, -1.0]))
        self.weight("flat", np.array([0, 6, -1]), onnx.TensorProto.INT64)
        self.weight("four", np.array([0, 4]), onnx.TensorProto.INT64)

    def weight(self, name: str, values: np.ndarray, kind: int | None = None) -> None:
        dtype = helper.tensor_dtype_to_np_dtype(self.kind if kind is None else kind)
        self.weights.append(numpy_helper.from_array(np.asarray(values, dtype), name))

    def node(self, operation: str, inputs: str, outputs: str, **attributes: object) -> None:
        self.nodes.append(
            helper.make_node(operation, inputs.split(), outputs.split(), name=outputs.split()[0], **attributes)
        )

    def body(
        self, images: str = "images", bias: str = "bias", grid: str = "grid", norm: str = "", **stem: object
    ) -> None:
        """norm: inputs of a batch norm after the first convolution; stem: attributes of that convolution."""
        self.node("Conv", f"{images} first", "plain" if norm else "stem", strides=[8, 8], **stem)
        if norm:
            self.node("BatchNormalization", f"plain {norm}", "stem")
        self.node("Sigmoid", "stem", "gate")
        self.node("Mul", "stem gate", "active")
        self.node("Conv", f"active second {bias}", grid, pads=[1, 1, 1, 1])

    def head(self, flat: str = "flat") -> None:
        self.node("Reshape", f"grid {flat}", "rows")
        self.weight("cut", np.array([4]), onnx.TensorProto.INT64)
        self.weight("from", np.array([0]), onnx.TensorProto.INT64)
        self.weight("to", np.array([6]), onnx.TensorProto.INT64)
        self.weight("axis", np.array([1]), onnx.TensorProto.INT64)
        self.node("Slice", "rows from cut axis", "boxes")
        self.node("Slice", "rows cut to axis", "logits")
        self.node("Sigmoid", "logits", "scores")
        self.node("Concat", "boxes scores", "output", axis=1)

    def finished(self, flat: str = "flat", **body: object) -> "Made":
        self.body(**body)
        self.head(flat)
        return self

    def save(
        self, path: Path, batch: int | str = "batch", sides: tuple = (SIDE, SIDE), opset: int = 13, **said: str
    ) -> Path:
        inputs = [helper.make_tensor_value_info("images", self.kind, [batch, 3, *sides])]
        outputs = [helper.make_tensor_value_info("output", self.kind, None)]
        graph = helper.make_graph(self.nodes, "made", inputs, outputs, self.weights)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
        helper.set_model_props(model, {"names": NAMES} | said)
        onnx.save(model, str(path))
        return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return Made().finished().save(tmp_path / "made.onnx")


def close(converted: OnnxDetector) -> None:
    """The detector says the same of five images at once as onnxruntime does one by one."""
    session = Session(read_model(converted.path))
    inputs = converted.pixels.apply(torch.rand(5, 3, *converted.input_size))
    found = converted.answer(inputs)
    expected = [converted.decode(session(image), converted.input_size) for image in inputs.split(1)]
    torch.testing.assert_close(found.boxes, torch.cat([e.boxes for e in expected]), atol=1e-3, rtol=0)
    torch.testing.assert_close(found.classes, torch.cat([e.classes for e in expected]), atol=1e-5, rtol=0)


def test_a_file_trains(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    detector = load_detector(f"onnx:{path}")
    assert detector.differentiable and detector.person == 1 and not caplog.records
    assert detector.source["layout"] == "yolov8" and detector.input_size == (SIDE, SIDE)
    assert detector.operating_point == 0.25 and detector.operating_point_assumed
    close(detector)
    before, after = lowers_score(detector, images(2, 90, 60))
    assert bool((after < before).all())
    kinds = {type(module).__name__ for module in detector.modules()}
    assert not kinds & {"OnnxSlice", "OnnxReshape", "OnnxBinaryMathOperation"}  # numbers where tensors were


def test_tells_the_best_other_class(path: Path) -> None:
    assert load_detector(f"onnx:{path}").class_names == ("cat", "person")
    others_are_the_rest(lambda number: load_detector(f"onnx:{path}@person={number}"), 2, 1, images(2, 90, 60))
    original = load_detector(f"onnx:{path}").original()
    assert original.class_names == ("cat", "person") and original(images(2, 90, 60)).other is not None


def test_a_reshape_of_a_fixed_batch_is_run_image_by_image(tmp_path: Path, caplog) -> None:
    made = Made()
    made.weight("fixed", np.array([1, 6, -1]), onnx.TensorProto.INT64)
    made.finished("fixed")
    path = made.save(tmp_path / "fixed.onnx")
    with caplog.at_level(logging.WARNING):
        detector = load_detector(f"onnx:{path}")
    assert "a batch goes wrong in it; its images are run one by one" in caplog.text
    assert detector.differentiable and detector.network.one_by_one
    close(detector)
    before, after = lowers_score(detector, images(2, 90, 60))
    assert bool((after < before).all())


def test_integers_are_a_black_box(tmp_path: Path, caplog) -> None:
    made = Made()
    made.weight("scale", np.array(1 / 255))
    made.weight("zero", np.array(0), onnx.TensorProto.UINT8)
    made.node("QuantizeLinear", "images scale zero", "bytes")
    made.node("DequantizeLinear", "bytes scale zero", "back")
    made.finished(images="back")
    with caplog.at_level(logging.WARNING):
        detector = load_detector(f"onnx:{made.save(tmp_path / 'int8.onnx')}")
    assert "a black box, good for evaluation alone: it computes in integers (bytes, back)" in caplog.text
    assert not detector.differentiable
    assert detector(images(2, SIDE, SIDE)).scores.shape == (2, 64)
    with pytest.raises(InputError, match="a black box without gradients: evaluate with it, do not train"):
        detector(images(1, SIDE, SIDE).requires_grad_())


def test_what_is_wrong_in_torch_is_not_trained_against(path: Path, monkeypatch, caplog) -> None:
    monkeypatch.setattr(comparing, "SCORES", -1.0)
    with caplog.at_level(logging.WARNING):
        detector = load_detector(f"onnx:{path}")
    assert "converted to torch it answers otherwise than in onnxruntime" in caplog.text
    assert not detector.differentiable


def test_pixels_as_the_spec_says(path: Path) -> None:
    plain = load_detector(f"onnx:{path}@stretch")
    other = load_detector(f"onnx:{path}@stretch,bgr,range=255,mean=255/0/0,std=255/255/255")
    batch = images(2, SIDE, SIDE)
    flipped = batch.flip(1)
    flipped[:, 0] -= 1
    torch.testing.assert_close(other(batch).scores, plain.answer(flipped).classes[..., 1])
    assert detector_record(plain) != detector_record(other)


def test_sizes_and_layouts_that_do_not_fit(path: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="its input is fixed to 64x64, it cannot run at 96x96"):
        load_detector(f"onnx:{path}@96")
    with pytest.raises(InputError, match=r"outputs output \[1, 6, 64\] are not laid out as fastestdet"):
        load_detector(f"onnx:{path}:fastestdet")
    with pytest.raises(InputError, match="unknown layout 'yolo9'; known are yolov5"):
        load_detector(f"onnx:{path}:yolo9")
    made = Made()
    made.body(grid="output")
    with pytest.raises(InputError, match=r"output \[1, 6, 8, 8\] are of no known layout; say onnx:FILE:LAYOUT"):
        load_detector(f"onnx:{made.save(tmp_path / 'grid.onnx')}")


def test_files_that_are_no_such_model(tmp_path: Path) -> None:
    for content in (b"", b"PK\x03\x04 a TorchScript archive", b"\x80\x02}q\x00.", b"{}"):
        (tmp_path / "m.onnx").write_bytes(content)
        with pytest.raises(InputError, match=r"m\.onnx: not an ONNX file"):
            load_detector(f"onnx:{tmp_path / 'm.onnx'}")
    with pytest.raises(InputError, match=r"none.onnx: no such file"):
        load_detector("onnx:none.onnx")
    path = Made().finished().save(tmp_path / "two.onnx")
    model = onnx.load(str(path))
    model.graph.input.append(helper.make_tensor_value_info("scale", FLOAT, [1]))
    onnx.save(model, str(path))
    with pytest.raises(InputError, match=r"has 2 inputs \(images, scale\), not one of images"):
        load_detector(f"onnx:{path}")


def test_weights_outside_the_folder_are_not_read(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    path = Made().finished().save(tmp_path / "in" / "m.onnx")
    model = onnx.load(str(path))
    onnx.save(model, str(path), save_as_external_data=True, location="m.data", size_threshold=0)
    assert load_detector(f"onnx:{path}").differentiable
    (tmp_path / "in" / "m.data").rename(tmp_path / "m.data")
    with pytest.raises(InputError, match=r"m\.data: no such file"):
        load_detector(f"onnx:{path}")
    path.write_bytes(path.read_bytes().replace(b"m.data", b"../m.d"))
    with pytest.raises(InputError, match=r"keeps weights in \.\./m.d, outside its folder"):
        load_detector(f"onnx:{path}")


def test_pixels_are_tried_where_nobody_says(path: Path, tmp_path: Path) -> None:
    from PIL import Image

    from cloak_core.detectors.check import check_image

    Image.fromarray(np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)).save(tmp_path / "a.png")
    detector = load_detector(f"onnx:{path}")
    found = check_image(detector, tmp_path / "a.png")
    assert set(found["pixels"]) == set(found["pixels_plausible"]) and found["pixels_undecided"]
    assert found["pixels"]["rgb"] == pytest.approx(found["max_person"])
    for options in ("bgr", "range=255", "bgr,range=255"):
        own = check_image(load_detector(f"onnx:{path}@{options}"), tmp_path / "a.png")
        assert "pixels" not in own and own["max_person"] == pytest.approx(found["pixels"][options], abs=1e-6)


def test_the_check_is_made_once_for_each_content(path: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("CLOAK_CACHE", str(tmp_path / "cache"))
    load_detector(f"onnx:{path}")
    from cloak_core.detectors.onnx_family import detector as module

    monkeypatch.setattr(module, "compare", lambda *_: pytest.fail("compared again"))
    path.rename(tmp_path / "moved.onnx")
    assert load_detector(f"onnx:{tmp_path / 'moved.onnx'}").differentiable
