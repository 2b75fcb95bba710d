"""Whatever makes views can be evaluated and reported: here people in photographs, which have no angle."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from torch import Tensor

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.images import ImageSet
from cloak_core.core.logo import Cover
from cloak_core.core.view import BakedView
from cloak_core.patterns.controls import OwnClothing
from cloak_core.patterns.faces import FacePattern
from cloak_core.products.run_report import make_report
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies.evaluate import Shown, evaluate
from cloak_core.studies.report.stored import FOLDER, read_evaluation
from tests.core.fakes import MadeViews, photograph_view

SETTINGS = EvaluateSettings(size=32, shift=0, resamples=100, batch=4, controls=(), bare=2)
COVER = Cover(np.zeros(1, np.int64), "photographs")
PATTERNS = {"logo": FacePattern(COVER, colors=np.full((1, 3), 0.2, np.float32)), "clothing": OwnClothing(COVER)}


def photograph() -> BakedView:
    """A person who fills the middle of her photograph in one colour, beside a passer-by."""
    mask = torch.zeros(32, 32, dtype=torch.bool)
    mask[4:28, 4:28] = True
    view = photograph_view(torch.zeros(3, 32, 32), mask, ((29, 0, 32, 32),), worn=True)
    return replace(view, own=torch.full((1, 3), 0.8))


def photographs() -> ImageSet:
    """Six photographs of three people; no angle, no distance, no background."""
    trials = pd.DataFrame({"pose": [0, 0, 1, 1, 2, 2], "photograph": list("uvwxyz")})
    behind = Backgrounds(["street", "square"], lambda index, height, width: np.zeros((height, width, 3), np.uint8))
    names = ("Ada", "Bo", "Cy"), tuple(behind.names)
    return ImageSet(MadeViews(*[photograph()] * 3), behind, (32, 32), "cpu", trials, *names)


class SeesBright(Detector):
    """Reports a small box on whoever is bright, a dog around others (or everyone), and a passer-by on the right."""

    class_names = ("person", "cat", "dog")

    def __init__(self, dog_always: bool = False) -> None:
        super().__init__("bright", "bright")
        self.dog_always = dog_always

    def detect(self, images: Tensor) -> Detections:
        person, count = images.mean((1, 2, 3)), len(images)
        boxes = torch.tensor([[10.0, 10, 16, 16], [4, 4, 28, 28], [29, 0, 32, 32]]).repeat(count, 1, 1)
        scores, other = torch.zeros(count, 3), torch.zeros(count, 3)
        scores[:, 0], scores[:, 2] = person, 0.9
        other[:, 1] = 0.7 if self.dog_always else torch.where(person < 0.5, 0.7, 0.0)
        return Detections(boxes, scores, other=other, other_class=torch.tensor([[1, 2, 1]]).repeat(count, 1))


@pytest.mark.slow
def test_photographs_are_evaluated_and_reported(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text("{}")
    circumstances = {"settings": {"threshold": 0.6, "size": 32}, "inputs": {"photographs": 6}, "warnings": []}
    circumstances |= {"unseen": {"bodies": True, "backgrounds": True}}
    shown = Shown(photographs(), PATTERNS, circumstances, lambda *_: {"flat": {}})
    summary = evaluate(shown, {"bright": SeesBright()}, SETTINGS, out=tmp_path / FOLDER)
    told = json.loads(json.dumps(summary, allow_nan=False))["detectors"]["bright"]
    assert told["by_angle"] == {} and set(told["by_body"]) == {"Ada", "Bo", "Cy"}
    assert told["logo"]["success"] == 1 and told["clothing"]["success"] == 0
    # The box is far smaller than the person: it counts as found because it lies within the person.
    assert told["clothing"]["success_iou"] == 0
    assert told["logo"]["renamed"] == 1 and told["logo"]["named"] == {"dog": 6} and told["clothing"]["renamed"] == 0
    always = evaluate(shown, {"bright": SeesBright(dog_always=True)}, SETTINGS)
    told = always["detectors"]["bright"]["logo"]
    assert (told["renamed"], told["gone"], told["named_own"]) == (0, 1, {}), "the dog stood there in their own clothes"
    assert summary["inputs"].keys() == {"photographs", "detector_hashes"}, "nobody knows the source's content"
    stored = read_evaluation(tmp_path / FOLDER)
    assert stored.results.trials["photograph"].tolist() == list("uvwxyz")
    assert [pair["body"] for pair in stored.pictures["gallery"]] == ["Ada", "Bo", "Cy"]
    assert {pair["angle"] for pair in stored.pictures["gallery"]} == {None} and stored.pictures["flat"] == {}
    text = make_report(tmp_path).read_text("utf-8")
    assert "Success by body" in text and "Success by angle" not in text and "None" not in text
