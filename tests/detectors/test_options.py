"""Which class, which precision, compiled or not: what detectors are told beside their spec."""

from pathlib import Path

import pytest
import torch

from cloak_core.core.detector.protocol import state_hash
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.errors import InputError
from tests.detectors.helpers import TINY_CFG, images, write_tiny

TWO_CLASSES = TINY_CFG.replace("classes=1", "classes=2").replace("filters=12", "filters=14")


@pytest.fixture
def spec(tmp_path: Path) -> str:
    return write_tiny(tmp_path, TWO_CLASSES, names=("cat", "tall pedestrian"))


def test_specs_are_taken_apart() -> None:
    parsed = parse_spec("darknet:C@t.cfg:b.weights@96x64,letterbox,person=tall pedestrian")
    assert (parsed.family, parsed.what, parsed.input_size) == ("darknet", "C@t.cfg:b.weights", (96, 64))
    assert parsed.letterbox and parsed.person_class == "tall pedestrian"
    plain = parse_spec("transformers:org/model@main")
    assert (plain.what, plain.input_size, plain.letterbox, plain.person_class) == ("org/model@main", None, False, None)


@pytest.mark.parametrize("suffix", ["", "@96", "@96,letterbox"])
def test_a_spec_says_which_class_it_looks_for(suffix: str, spec: str) -> None:
    """So that a run's record loads the same detector again."""
    with pytest.raises(InputError, match=r"no class 'person' among its 2 \(cat, tall pedestrian\)"):
        load_detector(spec + suffix)
    told = load_detector(spec + suffix, person_class="Tall Pedestrian")
    again = load_detector(told.spec)
    assert again.spec == told.spec and again.person == told.person == 1
    assert torch.equal(again(images()).scores, told(images()).scores)
    assert load_detector(spec + suffix, person_class="0").person == 0


@pytest.mark.parametrize(
    ("spec", "options", "message"),
    [
        ("builtin@person=person", {"person_class": "0"}, "says person= already; drop --person-class"),
        ("builtin@64,32", {}, "size is given twice"),
        ("builtin", {"person_class": "dog"}, r"no class 'dog' among its 1 \(person\)"),
        ("builtin", {"precision": "half"}, "--precision: 'half' is not one of float32, bfloat16, auto"),
        ("builtin", {"layout": "yolov8"}, "--layout is for onnx:FILE"),
        ("python:a.py:load", {"person_class": "1"}, "a python module returns the person's scores itself"),
    ],
)
def test_options_that_do_not_fit(spec: str, options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_detector(spec, **options)


def test_precision_is_automatic_only_where_it_gains(spec: str) -> None:
    assert load_detector(spec, person_class="1", precision="auto").precision == "float32"
    rough = load_detector(spec, person_class="1", precision="bfloat16")
    exact = load_detector(spec, person_class="1")
    found = rough(images())
    assert found.scores.dtype == torch.float32 and not torch.equal(found.scores, exact(images()).scores)
    torch.testing.assert_close(found.scores, exact(images()).scores, rtol=0, atol=0.02)


def test_compiled_runs_through_torch(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = []

    def compile(function):
        return lambda images: ran.append(len(images)) or function(images)

    monkeypatch.setattr(torch, "compile", compile)
    plain, compiled = (load_detector(spec, person_class="1", compiled=c) for c in (False, True))
    assert torch.equal(compiled(images(3)).scores, plain(images(3)).scores)
    assert ran == [3] and compiled.compiled and not plain.compiled and state_hash(compiled) == state_hash(plain)

    def fail(images):
        raise torch._inductor.exc.InvalidCxxCompiler

    monkeypatch.setattr(torch, "compile", lambda function: fail)
    with pytest.raises(InputError, match="--compile: torch cannot compile here"):
        load_detector(spec, person_class="1", compiled=True)(images())


def test_operating_points() -> None:
    builtin = load_detector("builtin")
    assert builtin.operating_point == 0.5 and not builtin.operating_point_assumed
    own = load_detector("builtin@conf=0.3")
    assert own.operating_point == 0.3 and not own.operating_point_assumed
    for options, words in (("bgr", "bgr, range, mean and std are for onnx:FILE"), ("stretch", "drop stretch")):
        with pytest.raises(InputError, match=words):
            load_detector(f"builtin@{options}")
