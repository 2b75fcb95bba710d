"""Detectors by their files alone, and what is meant by a typing error."""

from pathlib import Path

import pytest

from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.naming import full_spec, missing_file
from cloak_core.files.errors import InputError


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("yolov8n.onnx", "onnx:yolov8n.onnx"),
        ("models/a.ONNX@320,bgr", "onnx:models/a.ONNX@320,bgr"),
        ("a.onnx:yolov5@conf=0.4", "onnx:a.onnx:yolov5@conf=0.4"),
        ("yolo11s.pt", "ultralytics:yolo11s.pt"),
        ("net.xml", "openvino:net.xml"),
        ("x.tflite@256", "tflite:x.tflite@256"),
        ("jpeg=75:x.tflite", "jpeg=75:tflite:x.tflite"),
        ("a.cfg:b.weights@416", "darknet:a.cfg:b.weights@416"),
        (r"C:\models\a.onnx", r"onnx:C:\models\a.onnx"),
        ("builtin@224", "builtin@224"),
        ("onnx:a.onnx", "onnx:a.onnx"),
        ("python:a.py:load", "python:a.py:load"),
    ],
)
def test_a_file_is_taken_by_its_suffix(typed: str, meant: str) -> None:
    assert full_spec(typed) == meant


def test_darknet_finds_the_other_half(tmp_path: Path) -> None:
    for name in ("a.cfg", "a.weights", "b.cfg"):
        (tmp_path / name).touch()
    whole = f"darknet:{tmp_path / 'a.cfg'}:{tmp_path / 'a.weights'}"
    assert full_spec(str(tmp_path / "a.cfg")) == whole
    assert full_spec(f"{tmp_path / 'a.weights'}@416") == f"{whole}@416"
    assert full_spec(str(tmp_path / "b.cfg")) == f"darknet:{tmp_path / 'b.cfg'}:{tmp_path / 'a.weights'}"
    (tmp_path / "c.weights").touch()
    with pytest.raises(InputError, match=r"no b\.weights beside it; darknet:CFG:WEIGHTS names both"):
        full_spec(str(tmp_path / "b.cfg"))
    (tmp_path / "b_20000.weights").touch()
    assert full_spec(str(tmp_path / "b.cfg")) == f"darknet:{tmp_path / 'b.cfg'}:{tmp_path / 'b_20000.weights'}"
    assert full_spec(str(tmp_path / "b_20000.weights")) == full_spec(str(tmp_path / "b.cfg"))
    (tmp_path / "b_final.weights").touch()
    with pytest.raises(InputError, match=r"no b\.weights beside it; darknet:CFG:WEIGHTS names both"):
        full_spec(str(tmp_path / "b.cfg"))


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("builtn", "unknown family 'builtn'; did you mean builtin?"),
        ("onx:a.onnx", "unknown family 'onx'; did you mean onnx?"),
        ("yolo", "unknown family 'yolo'; expected a file, or builtin"),
        ("net.pth", "names no family; torchvision:NAME:net.pth?"),
    ],
)
def test_what_may_be_meant(typed: str, words: str) -> None:
    with pytest.raises(InputError) as said:
        load_detector(typed)
    assert words in str(said.value)


@pytest.mark.parametrize(
    ("name", "words"),
    [("net.torchscript", "export the network to .onnx"), ("model.safetensors", "transformers:DIRECTORY reads it")],
)
def test_a_file_of_another_runtime_is_refused_with_the_way(name: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    with pytest.raises(InputError, match=rf"no detector's file ends in {Path(name).suffix} .*; {words}"):
        load_detector(f"{tmp_path / name}@person=0")


def test_a_file_with_a_typing_error_is_suggested(tmp_path: Path) -> None:
    (tmp_path / "yolov8n.onnx").touch()
    with pytest.raises(InputError, match=r"yolov8m\.onnx: no such file; did you mean yolov8n\.onnx\?"):
        load_detector(str(tmp_path / "yolov8m.onnx"))
    with pytest.raises(InputError, match=r"none\.cfg: no such file$"):
        load_detector("darknet:none.cfg:none.weights")


def test_the_licence_of_the_extra_is_said_once(caplog: pytest.LogCaptureFixture, monkeypatch) -> None:
    monkeypatch.setattr("cloak_core.detectors.naming._said", set())
    full_spec("a.pt"), full_spec("b.pt")
    assert caplog.text.count("AGPL-3.0") == 1
    full_spec("ultralytics:a.pt")
    assert caplog.text.count("AGPL-3.0") == 1


def test_files_of_a_spec() -> None:
    assert missing_file("jpeg=75:onnx:no.onnx@320") == Path("no.onnx")
    assert missing_file("builtin") is None and missing_file("ultralytics:yolov8n.yaml") is None
