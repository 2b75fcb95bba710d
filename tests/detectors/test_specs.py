"""What people type for a detector, taken apart and loaded; what is said of typing errors."""

from pathlib import Path

import pytest
import torch

from cloak_core.core.detector.protocol import state_hash
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.naming import full_spec
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.errors import InputError
from cloak_core.files.specs import split_spec
from tests.detectors.helpers import TINY_CFG, images, write_tiny


@pytest.fixture
def spec(tmp_path: Path) -> str:
    cfg = TINY_CFG.replace("classes=1", "classes=2").replace("filters=12", "filters=14")
    return write_tiny(tmp_path, cfg, names=("cat", "tall pedestrian"))


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


def test_specs_are_taken_apart() -> None:
    parsed = parse_spec("darknet:C@t.cfg:b.weights@96x64,letterbox,person=tall pedestrian")
    assert (parsed.family, parsed.what, parsed.input_size) == ("darknet", "C@t.cfg:b.weights", (96, 64))
    assert parsed.letterbox and parsed.person_class == "tall pedestrian"
    plain = parse_spec("transformers:org/model@main")
    assert (plain.what, plain.input_size, plain.letterbox, plain.person_class) == ("org/model@main", None, False, None)


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


BAD = {
    "yolo": "unknown family 'yolo'; expected a file, or builtin",
    "builtn": r"unknown family 'builtn'; did you mean builtin\?",
    "onx:a.onnx": r"unknown family 'onx'; did you mean onnx\?",
    "net.pth": r"names no family; torchvision:NAME:net.pth\?",
    "a.cfg": "no a.weights beside it",
    "darknet:only.cfg": "expected darknet:CFG:WEIGHTS",
    "darknet:a::b": "expected darknet:CFG:WEIGHTS",
    "darknet:none.cfg:none.weights": "none.cfg: no such file",
    "darknet:a:b@0": "an input size of 0x0 is not possible",
    "onnx:a.onnx@5000x20": r"is not possible \(1 to 4096",
    "python:none.py:load": "none.py: no such file",
    "python:none.py": "expected python:FILE.py:FUNCTION",
    "python:a.py:load@person=dog": "a python module returns the person's scores itself, it has no class to choose",
    "builtin:x:y": r"expected builtin\[:WEIGHTS\], @OPTIONS",
    "builtin:x": "x: no such file",
    "builtin@64,32": "size is given twice",
    "builtin@bgr": "bgr, range, mean and std are for onnx:FILE",
    "builtin@stretch": "drop stretch",
    "onnx:a.onnx@conf=1.5": "conf=1.5 is not in",
    "onnx:a.onnx@mean=1/2/3,std=1/0/1": "a standard deviation of 0",
    "onnx:a.onnx@mean=1..2/2/3": "no number",
    "torchvision:fcos_resnet50_fpn:random@letterbox": "torchvision models resize by themselves; drop letterbox",
    "transformers:x@letterbox": "drop letterbox",
    "transformers:": "expected transformers:DIRECTORY",
}


@pytest.mark.parametrize("typed", BAD)
def test_what_cannot_be_meant_is_refused_before_anything_is_read(typed: str) -> None:
    with pytest.raises(InputError, match=BAD[typed]):
        load_detector(typed)


@pytest.mark.parametrize(
    ("spec", "options", "message"),
    [
        ("builtin@person=dog", {}, r"no class 'dog' among its 1 \(person\)"),
        ("builtin", {"precision": "half"}, "--precision: 'half' is not one of float32, bfloat16, auto"),
    ],
)
def test_options_that_do_not_fit(spec: str, options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_detector(spec, **options)


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


@pytest.mark.parametrize("options", ["@", "@96,", "@96,letterbox,"])
def test_a_spec_says_which_class_it_looks_for(options: str, spec: str) -> None:
    """So that a run's record loads the same detector again."""
    with pytest.raises(InputError, match=r"no class 'person' among its 2 \(cat, tall pedestrian\)"):
        load_detector(spec + options.rstrip("@,"))
    first = load_detector(f"{spec}{options}person=Tall Pedestrian")
    again = load_detector(first.spec)
    assert again.spec == first.spec and again.person == first.person == 1
    assert torch.equal(again(images()).scores, first(images()).scores)
    assert load_detector(f"{spec}{options}person=0").person == 0


def test_compiled_runs_through_torch(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = []

    def compile(function):
        return lambda images: ran.append(len(images)) or function(images)

    monkeypatch.setattr(torch, "compile", compile)
    plain, compiled = (load_detector(f"{spec}@person=1", compiled=c) for c in (False, True))
    assert torch.equal(compiled(images(3)).scores, plain(images(3)).scores)
    assert ran == [3] and compiled.compiled and not plain.compiled and state_hash(compiled) == state_hash(plain)

    def fail(images):
        raise torch._inductor.exc.InvalidCxxCompiler

    monkeypatch.setattr(torch, "compile", lambda function: fail)
    with pytest.raises(InputError, match="--compile: torch cannot compile here"):
        load_detector(f"{spec}@person=1", compiled=True)(images())


def test_precision_is_automatic_only_where_it_gains(spec: str) -> None:
    assert load_detector(f"{spec}@person=1", precision="auto").precision == "float32"
    rough = load_detector(f"{spec}@person=1", precision="bfloat16")
    exact = load_detector(f"{spec}@person=1")
    found = rough(images())
    assert found.scores.dtype == torch.float32 and not torch.equal(found.scores, exact(images()).scores)
    torch.testing.assert_close(found.scores, exact(images()).scores, rtol=0, atol=0.02)


def test_darknet_is_frozen_and_in_image_pixels(tmp_path: Path) -> None:
    detector = load_detector(write_tiny(tmp_path))
    assert detector.name == "tiny" and not detector.training
    assert not [p for p in detector.parameters() if p.requires_grad]
    small, large = detector(images(2, 64, 64)), detector(images(2, 128, 192))
    assert small.boxes.shape == (2, 2 * 8 * 8, 4) and small.objectness is not None and small.is_person is not None
    ratio = torch.tensor([3.0, 2.0, 3.0, 2.0])
    # The same picture at another size: the same boxes, scaled (bilinear up and down again is not quite the identity).
    torch.testing.assert_close(large.boxes / ratio, small.boxes, rtol=0, atol=2.0)
    torch.testing.assert_close(small.scores, small.objectness)


def test_letterbox_keeps_the_aspect_ratio(tmp_path: Path) -> None:
    detector = load_detector(write_tiny(tmp_path) + "@letterbox")
    wide = images(1, 64, 128)
    grey = torch.full((1, 3, 64, 64), 0.5)
    grey[:, :, 16:48] = torch.nn.functional.interpolate(wide, size=(32, 64), mode="bilinear", align_corners=True)
    inner = load_detector(write_tiny(tmp_path))(grey)
    outer = detector(wide)
    torch.testing.assert_close(outer.scores, inner.scores)
    torch.testing.assert_close(outer.boxes, (inner.boxes - torch.tensor([0.0, 16, 0, 16])) * 2)


def test_names_come_from_a_list_beside_the_cfg(tmp_path: Path) -> None:
    spec = write_tiny(tmp_path, names=None)
    with pytest.raises(InputError, match=r"names of its 1 classes are unknown; give @person="):
        load_detector(spec)
    assert load_detector(f"{spec}@person=0").name == "tiny"
    (tmp_path / "a.names").write_text("person\n")
    assert load_detector(spec).name == "tiny"
    (tmp_path / "b.names").write_text("dog\n")
    with pytest.raises(InputError, match=r"several .names files beside it list 1 classes"):
        load_detector(spec)
    with pytest.raises(InputError, match=r"tiny.names: 2 class names, but tiny.cfg has 1 classes"):
        load_detector(write_tiny(tmp_path, names=("person", "dog")))


def test_state_hash_sees_everything(tmp_path: Path) -> None:
    spec = write_tiny(tmp_path)
    detector, twin = load_detector(spec), load_detector(spec)
    before = state_hash(detector)
    assert before == state_hash(twin) and len(before) == 64
    detector(images().requires_grad_()).scores.sum().backward()
    assert state_hash(detector) == before
    assert state_hash(twin.to(memory_format=torch.channels_last)) == before
    twin.network.layers[0].conv.weight[0, 0, 0, 0] += 1e-7
    assert state_hash(twin) != before
    detector.network.layers[0].train()
    assert state_hash(detector) != before


@pytest.mark.parametrize(("suffix", "cells"), [("", 8 * 8), ("@32", 4 * 4), ("@32x128", 4 * 16), ("@64,letterbox", 64)])
def test_size_in_the_spec(suffix: str, cells: int, tmp_path: Path) -> None:
    assert load_detector(write_tiny(tmp_path) + suffix)(images()).scores.shape == (2, 2 * cells)
