"""The theorem of `masked=SIDE:SPEC`, by brute force over every place of a patch; one pixel blinds the detector."""

import itertools
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from cloak_core import cli
from cloak_core.core.detector.outcomes import share_within
from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.images import ImageSet
from cloak_core.core.logo import Cover
from cloak_core.detectors.defended.detector import defend
from cloak_core.detectors.defended.masks import EXPLAINED, spans
from cloak_core.patterns.controls import OwnClothing
from cloak_core.studies.clean import certified_recall
from tests.core.fakes import MadeViews, noise_backgrounds, photograph_view
from tests.detectors.helpers import write_tiny
from tests.sources.photographs.made_people import write_people

SIZE, WINDOW, PATCH = 20, 4, 3
BODY = (4.0, 4.0, 16.0, 16.0)
BLIND, DECOY = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


class Fragile(Detector):
    """Windows are people as far as they are bright. A red pixel anywhere blinds it, a blue one is a person all over."""

    def __init__(self) -> None:
        super().__init__("fragile", "fragile")
        self.freeze()

    def detect(self, images: torch.Tensor) -> Detections:
        bright = images.amin(1).unfold(1, WINDOW, 2).unfold(2, WINDOW, 2).mean((3, 4))
        places = torch.arange(0, SIZE - WINDOW + 1, 2.0)
        y, x = torch.meshgrid(places, places, indexing="ij")
        boxes = torch.stack([x, y, x + WINDOW, y + WINDOW], -1).flatten(0, 1)
        boxes = torch.cat([boxes, torch.tensor([[0.0, 0.0, SIZE, SIZE]])]).expand(len(images), -1, 4)
        sees = lambda color: (images == torch.tensor(color)[:, None, None]).all(1).flatten(1).any(1).float()[:, None]
        scores = torch.cat([bright.flatten(1) * (1 - sees(BLIND)), sees(DECOY)], 1)
        return Detections(boxes, scores)


def person() -> torch.Tensor:
    image = torch.full((3, SIZE, SIZE), 0.1)
    image[:, 4:16, 4:16] = 0.9
    return image


@pytest.mark.parametrize("length", [1, 5, 20, 33, 416])
@pytest.mark.parametrize("patch", [1, 3, 7, 32])
def test_a_mask_covers_every_place_of_the_patch(length: int, patch: int) -> None:
    placed, patch = spans(length, patch), min(length, patch)
    assert len(placed) <= 6 and all(0 <= begin < end <= length for begin, end in placed)
    for at in range(length - patch + 1):
        assert any(begin <= at and at + patch <= end for begin, end in placed)


@pytest.mark.long
def test_what_is_certified_holds_for_every_place_and_content_of_the_patch() -> None:
    inner = Fragile()
    defended, body = defend(inner, f"masked={PATCH}"), torch.tensor([BODY])
    on_body = lambda found: torch.where(share_within(found.boxes, body) >= 0.5, found.scores, 0.0).amax(1)
    floor = torch.stack([on_body(found) for found in defended.defence.answers(inner, person()[None])]).amin()
    assert floor > 0.8, "some window of the person is under no mask"
    windows = [
        torch.tensor([x, y, x + WINDOW, y + WINDOW])
        for y, x in itertools.product(range(4, 13, 2), repeat=2)  # windows on the body alone
    ]
    attacked = []
    for y, x in itertools.product(range(SIZE - PATCH + 1), repeat=2):
        for colors in ((BLIND,), (DECOY,), (BLIND, DECOY), ((0.0, 0.0, 0.0),)):
            image = person()
            for k, color in enumerate(colors):
                image[:, y : y + PATCH, x + k : x + PATCH] = torch.tensor(color)[:, None, None]
            attacked.append(image)
    attacked = torch.stack(attacked)
    assert (inner(attacked).scores[:, :-1].amax(1) == 0).any(), "the patch works on the detector alone"
    found = defended(attacked)
    inside = torch.stack([_held(window, found.boxes) for window in windows], -1).amax(-1)
    kept = ((found.scores >= floor) & (inside >= EXPLAINED)).any(1)
    assert kept.all(), f"{(~kept).sum()} patches hide the certified person"


def _held(window: torch.Tensor, boxes: torch.Tensor) -> torch.Tensor:
    """The share of a window that lies in each box."""
    sides = (torch.minimum(boxes[..., 2:], window[2:]) - torch.maximum(boxes[..., :2], window[:2])).clamp(min=0)
    return sides.prod(-1) / WINDOW**2


def test_boxes_under_masks_that_the_whole_image_explains_are_dropped() -> None:
    defended = defend(Fragile(), f"masked={PATCH}")
    found, alone = defended(person()[None]), Fragile()(person()[None])
    clean = int((alone.scores > 0.8).sum())
    assert int((found.scores > 0.8).sum()) == clean > 0, "nothing is reported twice"
    assert found.boxes.shape[1] == alone.boxes.shape[1] + 36 * alone.boxes.shape[1]


def stills() -> ImageSet:
    """One person in clear view and one of whom a mask hides more than half."""
    small = torch.full((3, SIZE, SIZE), 0.1)
    small[:, 8:12, 8:12] = 0.9
    views = [photograph_view(image, image[0] > 0.5) for image in (person(), small)]
    return ImageSet(MadeViews(*views), noise_backgrounds(), (SIZE, SIZE), trials=pd.DataFrame({"pose": [0, 1]}))


def test_certified_recall_is_the_share_found_under_every_mask() -> None:
    own = OwnClothing(Cover(np.zeros(1, np.int64), "stills"))
    told = certified_recall(defend(Fragile(), f"masked={PATCH}"), stills(), own, 0.7)
    assert told == {"certified_recall": 0.5, "certified_recall_own": 1.0, "patch": PATCH}
    assert certified_recall(Fragile(), stills(), own, 0.7) == {}, "without masks nothing is certified"


@pytest.mark.slow
def test_the_command_certifies_people_in_photographs(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    people = write_people(tmp_path / "people", 2)
    with pytest.raises(SystemExit) as caught:
        cli.main(["detectors", "check", f"masked=16:{write_tiny(tmp_path)}", "--people", str(people), "--json"])
    told = json.loads(capfd.readouterr().out)
    assert caught.value.code == 0 and (told["n"], told["patch"]) == (2, 16)
    assert told["certified_recall_own"] <= told["clean_recall_own"]
