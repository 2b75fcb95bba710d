"""The example that makes a PEOPLE file: what it writes, the library reads."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from cloak_core.sources.photographs.people import load_people
from tests.sources.photographs.made_people import annotation, photograph, standing

pytestmark = pytest.mark.slow
FILE = Path(__file__).parents[2] / "examples" / "people_file.py"


class Answer(nn.Module):
    """A model that always says the same."""

    def __init__(self, **said: torch.Tensor) -> None:
        super().__init__()
        self.said = said

    def forward(self, images: list) -> list[dict]:
        return [self.said for _ in images]


def test_what_the_example_writes_can_be_dressed(tmp_path):
    spec = importlib.util.spec_from_file_location("people_file", FILE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    record, triangle = annotation(standing(), kind="coco")
    mask = triangle >= 0
    photograph(mask).save(tmp_path / "one.png")
    x, y, w, h = record["bbox"]
    box, one = torch.tensor([[x, y, x + w, y + h]]).float(), torch.ones(1)
    points = torch.tensor(record["keypoints"]).reshape(1, 17, 3).float()
    keypoints = Answer(boxes=box, scores=one, keypoints=points, keypoints_scores=5 * points[..., 2])
    masks = Answer(boxes=box, labels=one.long(), scores=one, masks=torch.from_numpy(mask)[None, None].float())
    (tmp_path / "people.json").write_text(json.dumps(example.people_file(tmp_path, keypoints, masks)))
    (person,) = load_people(tmp_path / "people.json").people
    assert np.array_equal(person.mask, mask[-person.mask.shape[0] :])
