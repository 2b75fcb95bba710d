"""Whatever renders the views can be evaluated and reported: here people in photographs, which have no angle."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from torch import Tensor

from cloak_core.core.detector.outcomes import OnBody, on_body
from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.evaluation.renderer import EvaluationRenderer
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.products.run_report import make_report
from cloak_core.studies.evaluate import FOLDER, evaluate_renderer, read_evaluation

SETTINGS = EvaluateSettings(size=32, shift=0, resamples=100, batch=4, controls=(), bare=2)
COLORS = {"logo": 0.2, "clothing": 0.8}


class Photographs:
    """Six photographs of three people, in a colour for each control; no angle, no distance, no background."""

    body_names = ("Ada", "Bo", "Cy")
    background_names = ("street", "square")

    def __init__(self) -> None:
        self.trials = pd.DataFrame({"pose": [0, 0, 1, 1, 2, 2], "photograph": list("uvwxyz")})

    def views(self, indices: Sequence[int] | np.ndarray) -> list:
        return []

    def compose(self, views: list, indices: Sequence[int] | np.ndarray, controls: Sequence[str]) -> Iterator[Tensor]:
        for control in controls:
            yield torch.full((len(indices), 3, 32, 32), COLORS[control])

    def boxes(self, views: list, indices: Sequence[int] | np.ndarray) -> Tensor:
        return torch.tensor([[4.0, 4, 28, 28]]).repeat(len(indices), 1)

    def about_person(self, detections: Detections, views: list, indices: Sequence[int] | np.ndarray) -> Detections:
        return detections._replace(scores=detections.scores.where(detections.boxes[..., 0] < 20, 0))

    def on_person(self, detections: Detections, views: list, indices: Sequence[int] | np.ndarray) -> OnBody:
        return on_body(detections, self.boxes(views, indices))

    def bare(self, backgrounds: Sequence[int] | np.ndarray) -> Tensor:
        return torch.zeros(len(backgrounds), 3, 32, 32)

    def flat_views(self) -> dict[str, Tensor]:
        return {}


class SeesBright(Detector):
    """Reports a small box on whoever is bright, a dog around everyone, and a passer-by on the right."""

    class_names = ("person", "cat", "dog")

    def __init__(self) -> None:
        super().__init__("bright", "bright")

    def detect(self, images: Tensor) -> Detections:
        person, count = images.mean((1, 2, 3)), len(images)
        boxes = torch.tensor([[10.0, 10, 16, 16], [4, 4, 28, 28], [29, 0, 32, 32]]).repeat(count, 1, 1)
        scores, other = torch.zeros(count, 3), torch.zeros(count, 3)
        scores[:, 0], other[:, 1], scores[:, 2] = person, 0.7, 0.9
        return Detections(boxes, scores, other=other, other_class=torch.tensor([[1, 2, 1]]).repeat(count, 1))


@pytest.mark.slow
def test_photographs_are_evaluated_and_reported(tmp_path: Path) -> None:
    renderer = Photographs()
    assert isinstance(renderer, EvaluationRenderer)
    (tmp_path / "config.json").write_text("{}")
    circumstances = {"settings": {"threshold": 0.6, "size": 32}, "inputs": {"photographs": 6}, "warnings": []}
    circumstances |= {"unseen": {"bodies": True, "backgrounds": True}}
    place = {"out": tmp_path / FOLDER}
    summary = evaluate_renderer(renderer, {"bright": SeesBright()}, SETTINGS, circumstances, **place)
    told = json.loads(json.dumps(summary, allow_nan=False))["detectors"]["bright"]
    assert told["by_angle"] == {} and set(told["by_body"]) == {"Ada", "Bo", "Cy"}
    assert told["logo"]["success"] == 1 and told["clothing"]["success"] == 0
    # The box is far smaller than the person: it counts as found because it lies within the person.
    assert told["clothing"]["success_iou"] == 0
    assert told["logo"]["renamed"] == 1 and told["logo"]["named"] == {"dog": 6} and told["clothing"]["renamed"] == 0
    assert summary["inputs"].keys() == {"photographs", "detector_hashes"}
    stored = read_evaluation(tmp_path / FOLDER)
    assert stored.results.trials["photograph"].tolist() == list("uvwxyz")
    assert [pair["body"] for pair in stored.pictures["gallery"]] == ["Ada", "Bo", "Cy"]
    assert {pair["angle"] for pair in stored.pictures["gallery"]} == {None} and stored.pictures["flat"] == {}
    text = make_report(tmp_path).read_text("utf-8")
    assert "Success by body" in text and "Success by angle" not in text and "None" not in text
