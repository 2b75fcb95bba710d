"""MAITE's object-detection protocol, both ways."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from cloak_core import SuccessMetric, as_detector
from cloak_core.files.errors import InputError


@dataclass
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
