"""Python detectors that differ in one place are different; made again, or in another process, each is itself."""

import dataclasses
import enum
import functools
import importlib
import logging
import subprocess
import sys
import threading
import types
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch

from cloak_core import SuccessMetric
from cloak_core.core.detector.protocol import detector_record
from cloak_core.core.evaluate import identity
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.images import ImageSet
from cloak_core.detectors.loading import as_detector
from cloak_core.detectors.reachable import content_of
from cloak_core.files.errors import InputError
from cloak_core.studies.trained_run import trained_against
from tests.core.fakes import MadeViews, noise_backgrounds


def answer(picture: np.ndarray, score: float = 0.5) -> list:
    return [[0.0, 0.0, 9.0, 9.0, float(score)]]


LEVEL = 0.5


def reads_a_global(picture: np.ndarray) -> list:
    return answer(picture, LEVEL)


def with_global(level: object) -> Callable:
    return types.FunctionType(reads_a_global.__code__, {**globals(), "LEVEL": level})


def closing_over(value: object) -> Callable:
    return lambda picture: answer(picture, np.sum(value() if callable(value) else value))


def with_function_attribute(value: object) -> Callable:
    made = closing_over(1)
    made.level = value
    return made


class Called:
    def __init__(self, value: object) -> None:
        self.value = value

    def __call__(self, picture: np.ndarray) -> list:
        return answer(picture)

    def method(self, picture: np.ndarray) -> list:
        return answer(picture)


class Slotted:
    __slots__ = ("value",)

    def __init__(self, value: object) -> None:
        self.value = value

    def __call__(self, picture: np.ndarray) -> list:
        return answer(picture)


class Silent(Called):
    """What it would be pickled as does not tell what it is."""

    def __reduce_ex__(self, protocol: int) -> tuple:
        return Silent, (0,)


class Model(Called):
    metadata: ClassVar = {"id": "mine", "index2label": {0: "person"}}


@dataclasses.dataclass
class Record:
    value: object


class Kind(enum.Enum):
    FEW, MANY = 1, 2


class Net(torch.nn.Module):
    def __init__(self, **values: object) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.ones(1))
        vars(self).update(values)

    def forward(self, images: torch.Tensor) -> tuple:
        return images.new_zeros(len(images), 1, 4), self.scale.expand(len(images), 1)


def net_with_buffer(value: float) -> Net:
    net = Net()
    net.register_buffer("level", torch.tensor(value), persistent=False)
    return net


def cyclic(value: object) -> Called:
    made = Called([value])
    made.value.append(made)
    return made


def asks_a_module(value: object) -> Callable:
    made = types.ModuleType("helpers")
    made.level = value
    return types.FunctionType((lambda picture: helpers.level).__code__, {"helpers": made})  # noqa: F821


def class_with(value: object) -> type:
    return type("Made", (Called,), {"level": value})


ARRAY = np.arange(6, dtype=np.float32)
PAIRS = {
    "closure": (closing_over, 0.2, 0.3),
    "whole or not": (closing_over, 1, 1.0),
    "closure of a closure": (lambda v: closing_over(closing_over(v)), 1, 2),
    "closed over array": (closing_over, ARRAY, ARRAY + np.float32(1e-6)),
    "array of objects": (closing_over, np.array([1, None]), np.array([2, None])),
    "masked array": (closing_over, np.ma.array([1, 2], mask=[0, 1]), np.ma.array([1, 2], mask=[1, 0])),
    "tensor": (closing_over, torch.ones(3), torch.ones(3) * 2),
    "order of a list": (closing_over, [1, 2], [2, 1]),
    "list or tuple": (closing_over, [1], (1,)),
    "value in a dict": (closing_over, {"a": 1}, {"a": 2}),
    "set": (closing_over, {1, 2}, {1, 3}),
    "slice": (closing_over, slice(3), slice(4)),
    "path": (closing_over, Path("a"), Path("b")),
    "type of torch": (closing_over, torch.float16, torch.bfloat16),
    "member": (closing_over, Kind.FEW, Kind.MANY),
    "record": (closing_over, Record(1), Record(2)),
    "class as a value": (closing_over, Called, Slotted),
    "bound method": (lambda v: Called(v).method, 1, 2),
    "partial": (lambda v: functools.partial(answer, score=v), 0.1, 0.2),
    "wrapped": (lambda v: torch.no_grad()(closing_over(v)), 1, 2),
    "default": (lambda v: lambda picture, level=v: answer(picture, level), 0.2, 0.3),
    "default of a name": (lambda v: lambda picture, *, level=v: answer(picture, level), 0.2, 0.3),
    "attribute of a function": (with_function_attribute, 1, 2),
    "global": (with_global, 0.5, 0.6),
    "what a module holds": (asks_a_module, 0.5, 0.6),
    "attribute": (Called, 1, 2),
    "slot": (Slotted, 1, 2),
    "pickled otherwise": (Silent, 1, 2),
    "attribute of a class": (lambda v: class_with(v)(0), 1, 2),
    "attribute of a base": (lambda v: type("Heir", (class_with(v),), {})(0), 1, 2),
    "method of a class": (lambda v: class_with(v)(0), closing_over(1), closing_over(2)),
    "cycle": (cyclic, 1, 2),
    "model of MAITE's": (Model, 1, 2),
    "module's tensor that is none of its": (lambda v: Net(table=[torch.tensor(v)]), 1.0, 2.0),
    "module's function": (lambda v: Net(after=closing_over(v)), 1, 2),
    "module's buffer": (net_with_buffer, 1.0, 2.0),
    "code": (lambda v: v, lambda picture: [[0, 0, 1, 1, 0.5]], lambda picture: [[0, 0, 1, 1, 0.6]]),
    "code within code": (lambda v: v, lambda p: (lambda: 1)(), lambda p: (lambda: 2)()),
    "builtin of an object": (lambda v: v.get, {1: 2}, {1: 3}),
}  # fmt: skip


IMAGES = ImageSet(MadeViews(identity="known"), noise_backgrounds(1), (8, 8))


def record_of(thing: object) -> dict:
    detector = as_detector(thing)
    found = identity(IMAGES, {}, {"it": detector}, EvaluateSettings())
    return detector_record(detector) | {"found again by": found}


@pytest.mark.parametrize("name", PAIRS)
def test_two_that_differ_in_one_place_are_two(name: str) -> None:
    make, first, second = PAIRS[name]
    one, again, other = record_of(make(first)), record_of(make(first)), record_of(make(second))
    assert one == again and one["source"] != other["source"] and one["found again by"] != other["found again by"]
    assert "unknown" not in one["source"]["content"]


@pytest.mark.parametrize("make", [threading.Lock, lambda: (i for i in ()), lambda: sys.stdout])
def test_what_cannot_be_known_is_never_found_again(make: Callable) -> None:
    thing = make()
    first, second = record_of(closing_over(thing)), record_of(closing_over(thing))
    assert first["source"] != second["source"] and first["found again by"] != second["found again by"]
    assert trained_against({"detectors": [first]}, {"it": as_detector(closing_over(thing))}) == {"it": None}


def test_where_it_logs_decides_nothing() -> None:
    first, second = (record_of(Called([logging.getLogger(name)])) for name in ("a", "b"))
    assert first == second and "unknown" not in first["source"]["content"]


def test_an_object_that_changes_after_it_was_given_is_another() -> None:
    thing = Called(1)
    detector = as_detector(thing)
    trained = detector_record(detector)
    assert trained_against({"detectors": [trained]}, {"it": detector}) == {"it": True}
    thing.value = 2
    assert detector_record(detector) != trained
    assert trained_against({"detectors": [trained]}, {"it": detector}) == {"it": None}
    assert trained_against({"detectors": [trained]}, {"it": as_detector(answer)}) == {"it": False}


@pytest.mark.slow
def test_another_process_finds_the_same() -> None:
    script = "from tests.detectors.test_objects import contents; print(*contents())"
    there = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True).stdout.split()
    assert there == importlib.import_module("tests.detectors.test_objects").contents() and len(there) == 2 * len(PAIRS)


def contents() -> list[str]:
    return [content_of(make(value)) for make, *values in PAIRS.values() for value in values]


@dataclasses.dataclass
class Answer:
    """As MAITE's models answer, here in numpy."""

    boxes: np.ndarray
    labels: np.ndarray
    scores: np.ndarray


class Theirs:
    """A model of MAITE's protocol: brighter pictures have a surer person, and a dog where they are dark."""

    def __init__(self):
        self.metadata = {"id": "theirs", "index2label": {0: "dog", 1: "person"}}

    def __call__(self, images):
        assert all(image.ndim == 3 and image.shape[0] == 3 for image in images)
        boxes = np.array([[0, 0, 8, 9], [1, 1, 5, 5]])
        answers = []
        for k, image in enumerate(images):
            count = 1 + k % 2
            answers.append(
                Answer(boxes[:count], np.array([1, 0])[:count], np.array([float(image.mean()), 0.9])[:count])
            )
        return answers


def test_their_model_is_a_detector() -> None:
    detector = as_detector(Theirs())
    assert detector.spec == "theirs" and not detector.differentiable
    images = torch.stack([torch.full((3, 9, 8), 0.25), torch.full((3, 9, 8), 0.75)])
    found = detector(images)
    torch.testing.assert_close(found.scores.max(dim=1).values, torch.tensor([0.25, 0.75]))
    assert found.boxes[1, 0].tolist() == [0, 0, 8, 9]


def test_their_model_must_name_the_person() -> None:
    nameless = Theirs()
    nameless.metadata = {"id": "theirs"}
    with pytest.raises(InputError, match="MAITE model theirs: its metadata have no index2label"):
        as_detector(nameless)
    dogs = Theirs()
    dogs.metadata = {"id": "theirs", "index2label": {0: "dog", 1: "cat"}}
    with pytest.raises(InputError, match="theirs"):
        as_detector(dogs)


def test_our_measure_is_a_metric() -> None:
    metric = SuccessMetric(person=1)
    true = Answer(np.array([[0, 0, 10, 20], [30, 0, 40, 20]]), np.array([1, 1]), np.array([1.0, 1.0]))
    found = Answer(
        np.array([[0, 0, 10, 19], [30, 0, 40, 20], [0, 0, 10, 20]]), np.array([1, 1, 0]), np.array([0.9, 0.5, 1])
    )
    metric.update([found], [true])
    assert metric.compute() == {"success": 0.5, "persons": 2.0, "images": 1.0}
    nobody = Answer(np.zeros((0, 4)), np.zeros(0), np.zeros(0))
    metric.update([nobody, nobody], [true, nobody], [{}, {}])
    assert metric.compute() == {"success": 0.75, "persons": 4.0, "images": 3.0}
    metric.reset()
    assert np.isnan(metric.compute()["success"]) and metric.metadata["id"] == "cloak-success-0.6"
    pseudo = Answer(true.boxes, np.array([1, 1]), np.array([[0.0, 0.9], [0.9, 0.1]]))  # scores of every class
    metric.update([pseudo], [true])
    assert metric.compute()["success"] == 0.5
