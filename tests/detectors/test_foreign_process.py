"""Code and files of others leave the process as it was, end in time, and answer what a detector answers."""

import signal
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family import networks
from cloak_core.files.errors import InputError

CODE = """
import torch
IMPORT
class Mine(torch.nn.Module):
    def forward(self, images):
        CALL
        return images.new_zeros(len(images), 1, 4), images.mean((1, 2, 3))[:, None]
def load():
    LOAD
    return Mine()
"""


def save(path: Path, nodes: list, sides: list, constants: tuple = (), **said: str) -> None:
    """Write an ONNX file of these nodes, from `images` of these sides to `y`."""
    import onnx

    make, kinds = onnx.helper, onnx.TensorProto
    ends = [[make.make_tensor_value_info(name, kinds.FLOAT, shape)] for name, shape in (("images", sides), ("y", None))]
    graph = make.make_graph(nodes, "made", *ends, constants)
    model = make.make_model(graph, opset_imports=[make.make_opsetid("", 13)], ir_version=8)
    make.set_model_props(model, said)
    onnx.save(model, path)


def test_a_loop_without_end_is_ended(tmp_path, monkeypatch) -> None:
    """2^62 rounds."""
    onnx = pytest.importorskip("onnx")
    make, kinds = onnx.helper, onnx.TensorProto
    number, truth = make.make_tensor_value_info("i", kinds.INT64, []), make.make_tensor_value_info("c", kinds.BOOL, [])
    state = [make.make_tensor_value_info(name, kinds.FLOAT, None) for name in ("x", "xo")]
    steps = [make.make_node("Identity", ["c"], ["co"]), make.make_node("Sin", ["x"], ["xo"])]
    outputs = [make.make_tensor_value_info("co", kinds.BOOL, []), state[1]]
    body = make.make_graph(steps, "body", [number, truth, state[0]], outputs)
    constants = [onnx.numpy_helper.from_array(np.array(value), name) for value, name in ((1 << 62, "n"), (True, "t"))]
    loop = make.make_node("Loop", ["n", "t", "images"], ["y"], body=body)
    save(tmp_path / "endless.onnx", [loop], [1, 3, 32, 32], constants)
    monkeypatch.setattr(networks, "SECONDS", 0.5)
    with pytest.raises(InputError, match=r"endless\.onnx: a network that takes more than 0\.5 s for an image"):
        load_detector(f"onnx:{tmp_path / 'endless.onnx'}")


@pytest.mark.timeout(60, method="thread")  # its other method takes the process's alarm, which is what is tested
@pytest.mark.parametrize("wait", ["while True: pass", "import time; time.sleep(1000)"])
@pytest.mark.parametrize("where", ["IMPORT", "LOAD", "CALL"])
def test_code_that_never_returns_is_ended(where, wait, tmp_path, monkeypatch) -> None:
    text = CODE.replace(where, wait)
    for other in ("IMPORT", "CALL", "LOAD"):
        text = text.replace(other, "pass")
    file = tmp_path / "hanging.py"
    file.write_text(text)
    line = text.splitlines().index(next(row for row in text.splitlines() if wait in row)) + 1
    monkeypatch.setenv("CLOAK_DETECTOR_SECONDS", "0.3")
    before = signal.getsignal(signal.SIGALRM)
    with pytest.raises(InputError, match=rf"hanging\.py:load: .*hanging\.py:{line}: no answer in 0\.3 s"):
        load_detector(f"python:{file}:load")(torch.zeros(1, 3, 8, 8))
    assert signal.getsignal(signal.SIGALRM) is before and signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@pytest.mark.timeout(60, method="thread")
@pytest.mark.parametrize("said", ["soon", "-1", "nan"])
def test_a_limit_that_is_no_number_is_refused(said, tmp_path, monkeypatch) -> None:
    (tmp_path / "quick.py").write_text("import torch\nload = torch.nn.Identity\n")
    monkeypatch.setenv("CLOAK_DETECTOR_SECONDS", said)
    with pytest.raises(InputError, match=f"CLOAK_DETECTOR_SECONDS: '{said}' is no number of seconds"):
        load_detector(f"python:{tmp_path / 'quick.py'}:load")


@pytest.mark.timeout(60, method="thread")
def test_somebody_elses_alarm_is_left_alone(tmp_path, monkeypatch) -> None:
    (tmp_path / "quick.py").write_text("import torch\nload = torch.nn.Identity\n")
    monkeypatch.setenv("CLOAK_DETECTOR_SECONDS", "20")
    before = signal.signal(signal.SIGALRM, lambda *_: None)
    signal.setitimer(signal.ITIMER_REAL, 1000)
    try:
        load_detector(f"python:{tmp_path / 'quick.py'}:load")
        assert 900 < signal.getitimer(signal.ITIMER_REAL)[0] <= 1000
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("spec", ["builtin@8192", "onnx:a.onnx@5000x20", "python:a.py:load@4097"])
def test_inputs_that_nobody_can_run_are_refused(spec) -> None:
    with pytest.raises(InputError, match=r"an input size of \d+x\d+ is not possible \(1 to 4096"):
        load_detector(spec)


def test_a_file_that_asks_for_huge_images_is_refused(tmp_path) -> None:
    onnx = pytest.importorskip("onnx")
    mean = onnx.helper.make_node("ReduceMean", ["images"], ["y"], axes=[3])
    save(tmp_path / "huge.onnx", [mean], ["b", 3, "h", "w"], imgsz="[8192, 8192]")
    with pytest.raises(InputError, match=r"huge\.onnx: an input size of 8192x8192 is not possible"):
        load_detector(f"onnx:{tmp_path / 'huge.onnx'}")
