"""ONNX models of each output layout, made by hand so that the boxes are known."""

from pathlib import Path

import numpy as np
import pytest

from cloak_core.detectors.families import FAMILIES, list_families
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.protocol import state_hash
from cloak_core.detectors.scoring import person_boxes
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images

onnx = pytest.importorskip("onnx", reason="pip install onnx")
pytest.importorskip("onnxruntime", reason="pip install 'cloak-core[onnx]'")

SIDE = 32


def write(path: Path, *outputs: np.ndarray, names: str | None = None, batch: int | str = 1) -> Path:
    """A model that answers with these arrays, brighter pictures raising all of it a little."""
    helper, numpy_helper = onnx.helper, onnx.numpy_helper
    image = helper.make_tensor_value_info("images", onnx.TensorProto.FLOAT, [batch, 3, SIDE, SIDE])
    nodes = [helper.make_node("ReduceMean", ["images"], ["mean"], axes=[1, 2, 3], keepdims=1)]
    nodes.append(helper.make_node("Constant", [], ["zero"], value=numpy_helper.from_array(np.float32(0))))
    nodes.append(helper.make_node("Constant", [], ["flat"], value=numpy_helper.from_array(np.array([-1, 1, 1]))))
    nodes.append(helper.make_node("Mul", ["mean", "zero"], ["nothing"]))
    nodes.append(helper.make_node("Reshape", ["nothing", "flat"], ["column"]))
    infos = []
    for index, array in enumerate(outputs):
        value = numpy_helper.from_array(array.astype(np.float32))
        nodes.append(helper.make_node("Constant", [], [f"c{index}"], value=value))
        nodes.append(helper.make_node("Add", [f"c{index}", "column"], [f"out{index}"]))
        infos.append(helper.make_tensor_value_info(f"out{index}", onnx.TensorProto.FLOAT, [batch, *array.shape[1:]]))
    graph = helper.make_graph(nodes, "made", [image], infos)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    if names is not None:
        helper.set_model_props(model, {"names": names})
    onnx.save(model, str(path))
    return path


def yolox_rows() -> np.ndarray:
    rows = np.zeros((1, 16 + 4 + 1, 7))  # strides 8, 16, 32 on 32 px
    rows[0, 5] = [0.5, 0.25, np.log(2), np.log(1), 0.9, 0.1, 0.8]  # cell x=1, y=1 of stride 8
    return rows


ROW = [12.0, 10.0, 16.0, 8.0]
ROWS = {
    "yolov5": (np.array([[[*ROW, 0.9, 0.1, 0.8]] + [[1, 1, 1, 1, 0.1, 0.1, 0.1]] * 9]),),
    "yolov8": (np.concatenate([np.array([[*ROW, 0.1, 0.72]]).transpose()[None], np.zeros((1, 6, 9))], axis=2),),
    "yolox": (yolox_rows(),),
    "detr": (
        np.array([[[0.0, np.log(0.72 / 0.14), 0.0], [0.0, -9, 9]]]),
        np.array([[[12 / 32, 10 / 32, 16 / 32, 8 / 32], [0.5, 0.5, 0.1, 0.1]]]),
    ),
}


@pytest.mark.parametrize("layout", ROWS)
@pytest.mark.parametrize("batch", [1, "batch"])
def test_layouts(layout: str, batch: int | str, tmp_path: Path) -> None:
    path = write(tmp_path / "m.onnx", *ROWS[layout], names="{0: 'cat', 1: 'person'}", batch=batch)
    detector = load_detector(f"onnx:{path}:{layout}")
    assert not detector.differentiable and detector.input_size == (SIDE, SIDE)
    found = detector(images(2, 64, 64))  # twice the network's size
    for boxes in person_boxes(found, threshold=0.6):
        assert boxes[:, 4].tolist() == pytest.approx([0.72], abs=1e-5)
        assert boxes[0, :4].tolist() == pytest.approx([8.0, 12.0, 40.0, 28.0], abs=1e-3)


def test_layout_is_told_from_outputs_or_asked_for(tmp_path: Path) -> None:
    names = "{0: 'cat', 1: 'person'}"
    for layout in ("yolov8", "detr"):
        path = write(tmp_path / f"{layout}.onnx", *ROWS[layout], names=names)
        assert load_detector(f"onnx:{path}").layout == layout
    path = write(tmp_path / "v5.onnx", *ROWS["yolov5"], names=names)
    with pytest.raises(InputError, match="fit several layouts; say onnx:FILE:LAYOUT"):
        load_detector(f"onnx:{path}")
    with pytest.raises(InputError, match=r"v5.onnx: its outputs \[\[1, 10, 7\]\] are not laid out as yolox"):
        load_detector(f"onnx:{path}:yolox")
    with pytest.raises(InputError, match=r"v5.onnx: its outputs .* are not laid out as detr"):
        load_detector(f"onnx:{path}:detr")
    with pytest.raises(InputError, match="unknown layout 'yolo9'"):
        load_detector(f"onnx:{path}:yolo9")
    with pytest.raises(InputError, match="its input is fixed to 32x32"):
        load_detector(f"onnx:{path}:yolov5@64")


def test_black_box_refuses_training_and_hashes_its_file(tmp_path: Path) -> None:
    path = write(tmp_path / "m.onnx", *ROWS["yolov5"], names="{0: 'cat', 1: 'person'}")
    detector = load_detector(f"onnx:{path}:yolov5")
    with pytest.raises(InputError, match="black box without gradients: evaluate with it, do not train"):
        detector(images().requires_grad_())
    other = write(tmp_path / "n.onnx", *ROWS["yolov5"], names="{1: 'person', 0: 'dog'}")
    assert state_hash(detector) != state_hash(load_detector(f"onnx:{other}:yolov5"))


def test_names_are_needed(tmp_path: Path) -> None:
    path = write(tmp_path / "m.onnx", *ROWS["yolov5"])
    with pytest.raises(InputError, match="names of its 2 classes are unknown"):
        load_detector(f"onnx:{path}:yolov5")
    assert load_detector(f"onnx:{path}:yolov5", person_class="1").person == 1


def test_broken_files(tmp_path: Path) -> None:
    (tmp_path / "m.onnx").write_bytes(b"no model")
    with pytest.raises(InputError, match="not an ONNX model"):
        load_detector(f"onnx:{tmp_path / 'm.onnx'}")
    with pytest.raises(InputError, match=r"none.onnx: no such file"):
        load_detector("onnx:none.onnx")


def test_the_list_names_every_family() -> None:
    entries = list_families()["families"]
    assert {entry["family"] for entry in entries} == set(FAMILIES)
    assert [entry["family"] for entry in entries if not entry["trains"]] == ["onnx"]
    assert all(entry["installed"] == (entry["install"] is None) for entry in entries)
