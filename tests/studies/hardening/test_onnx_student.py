"""ONNX files and Python modules learn, and what was trained goes back into the file's own graph."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from cloak_core.studies.hardening.answers import Answer
from cloak_core.studies.hardening.student import Student
from cloak_core.studies.hardening.students import open_student
from tests.detectors.helpers import images
from tests.studies.hardening.made_students import (
    check_that_a_stopped_one_goes_on,
    disturb,
    learns,
)

onnx = pytest.importorskip("onnx", reason="pip install 'cloak-core[onnx]'")
pytest.importorskip("onnxruntime", reason="pip install 'cloak-core[onnx]'")
pytest.importorskip("onnx2torch", reason="pip install 'cloak-core[onnx]'")
from tests.detectors.test_onnx import HALF, SIDE, Made  # noqa: E402, of the packages above

numpy_helper, INT64 = onnx.numpy_helper, onnx.TensorProto.INT64


def arrays(path: Path) -> dict[str, np.ndarray]:
    """All weights of a file, initializers and Constant nodes, by name."""
    graph = onnx.load(str(path)).graph
    constants = {n.output[0]: n.attribute[0].t for n in graph.node if n.op_type == "Constant"}
    tensors = {tensor.name: tensor for tensor in graph.initializer} | constants
    return {name: numpy_helper.to_array(tensor) for name, tensor in tensors.items()}


def plain(made: Made) -> set[str]:
    made.finished()
    return {"first", "second", "bias"}


def copied_bias(made: Made) -> set[str]:
    """One bias for two convolutions, which read it under names of their own."""
    made.weight("third", np.random.default_rng(5).normal(0, 0.1, (6, 6, 1, 1)))
    made.node("Identity", "bias", "copy")
    made.node("Identity", "copy", "again")
    made.body(bias="copy", grid="rough")
    made.node("Conv", "rough third again", "grid")
    made.head()
    return {"first", "second", "third", "bias"}


def constant_copied_and_cast(made: Made) -> set[str]:
    """A bias in a Constant node, which the graph copies and casts, as exports in half precision do."""
    made.node("Constant", "", "offset", value=made.weights[2])
    made.node("Identity", "offset", "copy")
    made.node("Cast", "copy", "single", to=onnx.TensorProto.FLOAT)
    made.finished(bias="single")
    return {"first", "second", "offset"}


def read_elsewhere(made: Made) -> set[str]:
    """A bias that the graph adds once more: to train it for one use would change the other."""
    made.body(grid="rough")
    made.weight("column", np.array([1, 6, 1, 1]), INT64)
    made.node("Reshape", "bias column", "shaped")
    made.node("Add", "rough shaped", "grid")
    made.head()
    return {"first", "second"}


def whole_numbers(made: Made) -> set[str]:
    """Arithmetic by a convolution, as the expectation over distances in YOLOv8's head."""
    made.weight("permutes", np.eye(6)[[1, 0, 3, 2, 4, 5]][..., None, None])
    made.body(grid="rough")
    made.node("Conv", "rough permutes", "grid")
    made.head()
    return {"first", "second", "bias"}


def uneven_padding(made: Made) -> set[str]:
    made.finished(pads=[0, 0, 7, 7])
    return {"first", "second", "bias"}


def batch_norm(made: Made) -> set[str]:
    for name, values in (("scale", 1.1), ("shift", 0.2), ("mean", 0.1), ("variance", 0.8)):
        made.weight(name, np.full(8, values) + np.arange(8) / 50)
    made.finished(norm="scale shift mean variance")
    return {"first", "scale", "shift", "second", "bias"}


def shuffled(made: Made) -> set[str]:
    """Channels in another order, which conversion would put into the next convolution's weights."""
    made.weight("order", np.array([3, 1, 4, 0, 2, 6, 5, 7]), INT64)
    made.body()
    made.nodes[-1].input[0] = "turned"
    made.nodes.insert(-1, onnx.helper.make_node("Gather", ["active", "order"], ["turned"], name="turned", axis=1))
    made.head()
    return {"first", "second", "bias"}


def linear(transposed: bool, beta: float = 1.0) -> Callable[[Made], set[str]]:
    """A layer over all cells (Gemm; a bias times beta is not trained) and one over the channels (MatMul)."""

    def build(made: Made) -> set[str]:
        random = np.random.default_rng(6)
        made.weight("cells", 2 * np.eye(64) + random.normal(0, 0.01, (64, 64)))
        made.weight("offset", random.normal(0, 0.1, 64))
        made.weight("mixes", np.eye(6) + random.normal(0, 0.01, (6, 6)))
        made.weight("lines", np.array([-1, 64]), INT64)
        made.weight("back", np.array([-1, 6, 64]), INT64)
        made.body()
        made.head()
        slices = [node for node in made.nodes if node.op_type == "Slice"]
        at = made.nodes.index(slices[0])
        rest, made.nodes = made.nodes[at:], made.nodes[:at]
        made.node("MatMul", "mixes rows", "mixed")
        made.node("Reshape", "mixed lines", "flattened")
        made.node("Gemm", "flattened cells offset", "gemm", beta=beta, transB=int(transposed))
        made.node("Reshape", "gemm back", "linear")
        for node in slices:
            node.input[0] = "linear"
        made.nodes += rest
        return {"first", "second", "bias", "cells", "mixes"} | ({"offset"} if beta == 1 else set())

    return build


CASES = [
    plain,
    constant_copied_and_cast,
    copied_bias,
    read_elsewhere,
    whole_numbers,
    uneven_padding,
    batch_norm,
    shuffled,
    pytest.param(linear(False), id="linear"),
    pytest.param(linear(True), id="transposed"),
    pytest.param(linear(False, beta=2.0), id="bias times 2"),
]


def written(student: Student, folder: Path) -> str:
    folder.mkdir(exist_ok=True)
    return student.write(student.network.state_dict(), folder, 0)


@pytest.mark.parametrize("build", CASES)
def test_what_was_trained_goes_back_where_it_came_from_and_nothing_else_changes(
    build: Callable[[Made], set[str]], tmp_path: Path
) -> None:
    made = Made()
    trained = build(made)
    path = made.save(tmp_path / "made.onnx", license="theirs")
    student = open_student(f"onnx:{path}")
    assert set(student.detector.weights.parameters) == trained
    assert len(list(student.network.parameters())) == len(trained)

    spec = written(student, tmp_path / "out")
    assert spec == f"onnx:{tmp_path}/out/hardened.onnx"
    again = tmp_path / "out" / "hardened.onnx"
    assert onnx.load(str(again)) == onnx.load(str(path))

    for name in sorted(trained):
        alone = open_student(f"onnx:{path}")
        disturb(alone, name)
        written(alone, tmp_path / "out")
        pairs = {key: (values, arrays(again)[key]) for key, values in arrays(path).items()}
        assert {key for key, pair in pairs.items() if not np.array_equal(*pair)} == {name}
    disturb(student, *trained)
    detector = load_detector(written(student, tmp_path / "out"))
    batch = images(2, SIDE, SIDE)
    scores = detector(batch).scores
    torch.testing.assert_close(scores, student.detector(batch).scores, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(scores, detector.original()(batch).scores, atol=1e-4, rtol=0)
    assert float((scores - student.teacher(batch).scores).abs().max()) > 1e-3
    before, after = onnx.load(str(path)), onnx.load(str(again))
    for part in ("node", "input", "output"):
        if part != "node" or build is not constant_copied_and_cast:  # whose trained weight is a node
            assert list(getattr(before.graph, part)) == list(getattr(after.graph, part))
    assert list(before.metadata_props) == list(after.metadata_props)


def test_half_precision_and_weights_beside_the_file_are_written_as_they_were(tmp_path: Path) -> None:
    made = Made(HALF)
    plain(made)
    path = made.save(tmp_path / "half.onnx")
    model = onnx.load(str(path))
    onnx.save(model, str(path), save_as_external_data=True, location="half.data", size_threshold=0)
    student = open_student(f"onnx:{path}")
    disturb(student, "first")
    written(student, tmp_path / "out")
    old, new = arrays(path), arrays(tmp_path / "out" / "hardened.onnx")
    assert new["first"].dtype == np.float16 and not np.array_equal(new["first"], old["first"])
    assert np.array_equal(new["second"], old["second"])


def test_what_was_said_beside_the_file_stands_beside_the_new_one(tmp_path: Path) -> None:
    made = Made()
    plain(made)
    path = made.save(tmp_path / "m.onnx", names="")
    (tmp_path / "m.json").write_text(json.dumps({"confidence": 0.4, "layout": "yolov8"}))
    (tmp_path / "m.names").write_text("cat\nperson\n")
    detector = load_detector(written(open_student(f"onnx:{path}@stretch"), tmp_path / "out"))
    assert (detector.person, detector.operating_point, detector.letterbox) == (1, 0.4, False)


@pytest.mark.parametrize(
    ("inside", "beside", "named"),
    [("AGPL-3.0 License", "CC0", "AGPL-3.0"), ("", "weights: AGPL-3.0", "AGPL-3.0"), ("", None, "unknown")],
)
def test_licence_and_sidecar_are_those_of_the_file_that_was_hardened(
    inside: str, beside: str | None, named: str, tmp_path: Path
) -> None:
    made = Made()
    plain(made)
    path = made.save(tmp_path / "m.onnx", **({"license": inside} if inside else {}))
    old = {"file": "m.onnx", "sha256": "of the old", "verified": {"max_diff": 0}, "confidence": 0.4, "licence": beside}
    (tmp_path / "m.json").write_text(json.dumps(old))
    written(open_student(f"onnx:{path}"), tmp_path / "out")
    licence = (tmp_path / "out" / "hardened.licence.txt").read_text()
    assert named in licence and "MIT" not in licence and "CC0" not in licence
    said, data = (json.loads((tmp_path / "out" / "hardened.json").read_text()), tmp_path / "out" / "hardened.onnx")
    assert said["sha256"] == hashlib.sha256(data.read_bytes()).hexdigest() and said["file"] == "hardened.onnx"
    assert said["confidence"] == 0.4 and "verified" not in said


def test_a_student_learns_what_its_teacher_says(tmp_path: Path) -> None:
    made = Made()
    plain(made)
    student = open_student(f"onnx:{made.save(tmp_path / 'm.onnx')}")
    learns(student)


def test_a_student_whose_graph_chooses_learns_from_the_boxes_most_like_its_own(tmp_path: Path) -> None:
    made = Made()
    plain(made)
    made.nodes[-1].output[0] = made.nodes[-1].name = "all"
    made.weight("best", np.array([60]), INT64)
    made.weight("two", np.array([2]), INT64)
    made.nodes += [
        onnx.helper.make_node("ReduceMax", ["scores"], ["sure"], axes=[1], keepdims=0),
        onnx.helper.make_node("TopK", ["sure", "best"], ["highest", "order"]),
        onnx.helper.make_node("Gather", ["all", "order"], ["several"], axis=2),
        onnx.helper.make_node("Squeeze", ["several", "two"], ["output"]),
    ]
    student = open_student(f"onnx:{made.save(tmp_path / 'm.onnx', batch=1)}")
    learns(student)
    answer = student.answer(student.teacher, images(1, 64, 64))
    turned = Answer(answer.kinds.flip(1), answer.boxes.flip(1))
    torch.testing.assert_close(student.matched(answer, turned).boxes, answer.boxes)


@pytest.mark.parametrize(("build", "changes"), [(copied_bias, {}), (plain, {"perturbation": 0.02})])
def test_a_stopped_hardening_of_a_file_goes_on_to_the_same_bits(
    build: Callable[[Made], set[str]], changes: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Made()
    build(made)
    check_that_a_stopped_one_goes_on(f"onnx:{made.save(tmp_path / 'm.onnx')}", tmp_path, monkeypatch, **changes)


def integers(made: Made) -> None:
    made.weight("scale", np.array(1 / 255))
    made.weight("zero", np.array(0), onnx.TensorProto.UINT8)
    made.node("QuantizeLinear", "images scale zero", "bytes")
    made.node("DequantizeLinear", "bytes scale zero", "back")
    made.finished(images="back")


def closed(made: Made) -> None:
    made.body(grid="rough")
    made.node("Shrink", "rough", "grid", lambd=0.0)
    made.head()


def nothing_to_train(made: Made) -> None:
    made.weights[:2] = []
    copies, sums = np.zeros((8, 3, 8, 8)), np.zeros((6, 8, 3, 3))
    copies[np.arange(8), np.arange(8) % 3, 0, 0] = 1
    sums[np.arange(6), np.arange(6), 1, 1] = 3
    made.weight("first", copies)
    made.weight("second", sums)
    made.finished(bias="")


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (
            integers,
            r"m.onnx: its weights cannot be trained: it computes in integers \(bytes, back\); harden the weights",
        ),
        (
            closed,
            "m.onnx: its weights cannot be trained: no translation for .*Shrink.*; harden the weights that it was",
        ),
        (nothing_to_train, "m.onnx: has no weights of convolutions or linear layers that could be trained; harden the"),
    ],
)
def test_what_cannot_be_trained_is_refused_with_the_way(
    build: Callable[[Made], None], words: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    made = Made()
    build(made)
    path = made.save(tmp_path / "m.onnx")
    with pytest.raises(InputError, match=words):
        open_student(f"onnx:{path}")
    assert not caplog.records, "one line"


def test_a_file_that_has_changed_is_not_written_over(tmp_path: Path) -> None:
    made = Made()
    plain(made)
    path = made.save(tmp_path / "m.onnx")
    student = open_student(f"onnx:{path}")
    made.save(path, imgsz="[64, 64]")
    with pytest.raises(InputError, match=r"m.onnx: changed since it was loaded; the hardened weights are in the check"):
        written(student, tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nanodet_m", pytest.param("yolov8n", marks=pytest.mark.long)])
def test_a_real_file_is_hardened_as_the_file_that_it_is(name: str, shared: Path, tmp_path: Path) -> None:
    path = shared / "data" / "detectors" / f"{name}.onnx"
    student = open_student(f"onnx:{path}")
    weights = student.detector.weights.parameters
    most = sum(parameter.numel() for parameter in weights.values())
    assert most > 0.95 * sum(values.size for values in arrays(path).values() if values.dtype == np.float32)
    again = tmp_path / "out" / "hardened.onnx"
    written(student, tmp_path / "out")
    assert onnx.load(str(again)) == onnx.load(str(path))
    disturb(student, *weights)
    detector = load_detector(written(student, tmp_path / "out"))
    batch = images(2, 320, 320)
    scores = detector(batch).scores
    torch.testing.assert_close(scores, detector.original()(batch).scores, atol=1e-4, rtol=0)
    torch.testing.assert_close(scores, student.detector(batch).scores, atol=1e-4, rtol=0)
    assert set(arrays(again)) == set(arrays(path))
