"""Specs are taken apart alike on every system, and one table says what each family takes."""

import pytest

from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.errors import InputError
from cloak_core.files.specs import split_spec
from cloak_core.studies.report.words import short_name


@pytest.mark.parametrize(
    ("spec", "parts"),
    [
        (r"C:\dir\a.cfg:C:\dir\a.weights", [r"C:\dir\a.cfg", r"C:\dir\a.weights"]),
        ("d:/a.cfg:E:/b.weights", ["d:/a.cfg", "E:/b.weights"]),
        (r"C:\x\a.cfg", [r"C:\x\a.cfg"]),
        ("/x/a.cfg:b.weights", ["/x/a.cfg", "b.weights"]),
        ("a.py:f", ["a.py", "f"]),
        ("./a:/b", ["./a", "/b"]),
        ("64:0:", ["64", "0", ""]),
        ("C:x", ["C", "x"]),
    ],
)
def test_a_drive_letter_parts_nothing(spec: str, parts: list[str]) -> None:
    assert split_spec(spec) == parts


@pytest.mark.parametrize(
    ("spec", "parts"),
    [
        (r"darknet:C:\dir\a.cfg:C:\dir\a.weights@416,letterbox", [r"C:\dir\a.cfg", r"C:\dir\a.weights"]),
        (r"python:C:\dir\mine.py:load", [r"C:\dir\mine.py", "load"]),
        ("onnx:C:/dir/a.onnx:yolov8@person=0", ["C:/dir/a.onnx", "yolov8"]),
        (r"torchvision:fcos_resnet50_fpn:C:\w.pth", ["fcos_resnet50_fpn", r"C:\w.pth"]),
        ("builtin@224", []),
    ],
)
def test_detectors_on_windows_drives(spec: str, parts: list[str]) -> None:
    assert parse_spec(spec).parts == parts


def test_short_names_leave_folders_out() -> None:
    assert short_name(r"darknet:C:\dir\a.cfg:C:\dir\a.weights@224") == "darknet a @224"
    assert short_name("jpeg=75:blur=1:darknet:/dir/a.cfg:/dir/a.weights") == "jpeg=75 blur=1 darknet a"


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("torchvision:fcos_resnet50_fpn:random@letterbox", "torchvision models resize by themselves; drop letterbox"),
        ("transformers:x@letterbox", "drop letterbox"),
        ("python:a.py:load@person=dog", "has no class to choose"),
        ("transformers:", "expected transformers:DIRECTORY"),
        ("darknet:a::b", "expected darknet:CFG:WEIGHTS"),
    ],
)
def test_what_a_family_does_not_take_is_refused_before_anything_is_read(spec: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_detector(spec)
